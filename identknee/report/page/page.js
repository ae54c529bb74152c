"use strict";
// Numbers that are folded away are opened by a link to them, and on paper.
(() => {
  const openAround = (place) => {
    for (let node = place; node; node = node.parentElement) {
      if (node.tagName === "DETAILS") node.open = true;
    }
  };
  const openTarget = () => {
    const name = decodeURIComponent(location.hash.slice(1));
    if (name) openAround(document.getElementById(name));
  };
  addEventListener("hashchange", openTarget);
  openTarget();
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = [...document.querySelectorAll("details:not([open])")];
    folded.forEach((x) => { x.open = true; });
  });
  addEventListener("afterprint", () => folded.forEach((x) => { x.open = false; }));
})();
