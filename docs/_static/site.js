/* What the theme leaves to those who read with a screen reader or without a mouse. */
"use strict";
addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll("[role=heading]:not([aria-level])").forEach((node) => node.setAttribute("aria-level", "2"));
  document.querySelectorAll("aside").forEach((node, i) => node.setAttribute("aria-label", i ? "On this page" : "All pages"));
  /* What scrolls sideways must be reachable from the keyboard. */
  const reach = () => document.querySelectorAll("pre, .math-wrapper, .table-wrapper").forEach((box) => {
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
    else box.removeAttribute("tabindex");
  });
  addEventListener("resize", reach);
  reach();
});
