// What the theme leaves out for readers who use the keyboard or listen to the page.
addEventListener("load", () => {
  for (const part of document.querySelectorAll("table, pre, div.math, math")) {
    if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
  }
  // Its label would hide the words on the button.
  for (const button of document.querySelectorAll(".search-button-field")) {
    button.removeAttribute("aria-label");
  }
});
