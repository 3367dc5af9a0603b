"use strict";
// What every part of the page uses.
const page = {
  data: JSON.parse(document.getElementById("data")?.textContent ?? "null"),

  /** A new element; attributes by name, children as nodes or text. */
  make(name, attributes = {}, ...children) {
    const drawn = ["svg", "g", "path", "line", "text", "circle", "rect"].includes(name);
    const node = drawn ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  },

  /** Fill a select with texts, values 0, 1, ...; keeps the chosen text where it is still there. */
  choices(select, texts) {
    const before = select.selectedOptions[0]?.textContent;
    select.replaceChildren(...texts.map((text, index) => page.make("option", { value: index }, text)));
    select.selectedIndex = Math.max(0, texts.indexOf(before));
  },

  /** Show nodes in the floating box beside a point of the window. */
  tip(x, y, ...children) {
    const box = document.getElementById("tip");
    box.replaceChildren(...children);
    box.hidden = false;
    const { width, height } = box.getBoundingClientRect();
    box.style.left = `${Math.max(6, Math.min(x + 14, innerWidth - width - 6))}px`;
    box.style.top = `${y + 16 + height > innerHeight ? Math.max(6, y - height - 12) : y + 16}px`;
  },
  untip() { document.getElementById("tip").hidden = true; },
  say(text) { document.getElementById("said").textContent = text; },
  /** Say it in sight, for a moment. */
  notice(text) {
    const line = page.make("div", { class: "notice" }, text);
    document.body.append(line);
    setTimeout(() => line.remove(), 2500);
    page.say(text);
  },
};

// The reason of a gap: on hover and on focus. The link leads to the footnote, which says the same.
for (const link of document.querySelectorAll(".why")) {
  const reason = link.title;
  link.removeAttribute("title");
  link.setAttribute("aria-label", `${link.firstChild.textContent}: ${reason}`);
  const show = () => {
    const box = link.getBoundingClientRect();
    page.tip(box.left, box.bottom - 10, reason);
  };
  link.addEventListener("pointerenter", show);
  link.addEventListener("focus", show);
  link.addEventListener("pointerleave", page.untip);
  link.addEventListener("blur", page.untip);
}
document.addEventListener("keydown", (event) => { if (event.key === "Escape") page.untip(); });

// What is folded is printed too.
addEventListener("beforeprint", () => {
  for (const folded of document.querySelectorAll("details:not([open])")) { folded.open = true; folded.dataset.folded = ""; }
});
addEventListener("afterprint", () => {
  for (const opened of document.querySelectorAll("details[data-folded]")) { opened.open = false; delete opened.dataset.folded; }
});
