"use strict";
// For readers without a mouse or without a screen: what scrolls can be focused, and each part of a page has a name.
addEventListener("DOMContentLoaded", () => {
  const named = { ".sidebar-drawer": "Pages", ".toc-drawer": "Contents of this page" };
  for (const [part, name] of Object.entries(named)) document.querySelector(part)?.setAttribute("aria-label", name);
  if (!document.querySelector("h1")) {
    const heading = document.createElement("h1");
    heading.textContent = document.title;
    document.querySelector("[role=main]").prepend(heading);
  }
  const focus = () => {
    for (const box of document.querySelectorAll("pre, .table-wrapper, .math"))
      if (box.scrollWidth > box.clientWidth) box.tabIndex = 0; else box.removeAttribute("tabindex");
  };
  addEventListener("resize", focus);
  focus();
});
