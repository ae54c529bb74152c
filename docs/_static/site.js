// What the theme leaves out for readers who use the keyboard or listen to the page.
addEventListener("load", () => {
  for (const part of document.querySelectorAll("table, pre, div.math, math")) {
    if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
  }
  // The button is called by its words, also on a narrow page, which hides them.
  for (const button of document.querySelectorAll(".search-button-field")) {
    button.setAttribute("aria-label", button.textContent.replace(/\s+/g, " ").trim());
  }
});
