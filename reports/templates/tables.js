// Tables that sort by a click on a heading (numbers as numbers, and what has no number last, whichever way), and that can
// be copied as they are shown.
document.addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (button?.closest("table.sortable thead")) sortBy(button.closest("th"));
  if (button?.parentElement.classList.contains("copy")) {
    const table = button.closest(".tools").nextElementSibling.querySelector("table");
    copy(exporters[button.textContent](readTable(table)), button.textContent, table.caption.textContent.trim());
  }
});

function sortBy(heading) {
  const table = heading.closest("table"), body = table.tBodies[0], column = heading.cellIndex;
  const before = heading.getAttribute("aria-sort");
  const order = before ? (before === "ascending" ? "descending" : "ascending") : heading.dataset.first;
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", order);
  const sign = order === "ascending" ? 1 : -1;
  const rows = [...body.rows].map((row, index) => ({ row, index, key: sortKey(row.cells[column]) }));
  rows.sort((one, other) => {
    if (one.key === null || other.key === null) return (one.key === null) - (other.key === null) || one.index - other.index;
    return sign * compareKeys(one.key, other.key) || one.index - other.index;
  });
  body.append(...rows.map((entry) => entry.row));
  page.say(`Sorted by ${heading.textContent.trim()}, ${order}`);
}

function sortKey(cell) {
  const key = cell.dataset.sort;
  if (cell.classList.contains("number")) return key === undefined ? null : Number(key);
  const text = (key ?? cell.textContent).trim().toLowerCase();
  return text === "" ? null : /^-?[\d.]+$/.test(text) ? Number(text) : text;
}

function compareKeys(one, other) {
  if (typeof one === "number" && typeof other === "number") return one < other ? -1 : one > other ? 1 : 0;
  return String(one).localeCompare(String(other), "en", { numeric: true });
}

// ---- as CSV, LaTeX and Markdown ----

/** The shown rows of a table: headings as {group, text, words}, cells as {text, spread, rest, best, gap}. */
function readTable(table) {
  const [above, line] = table.tHead.rows.length > 1 ? [...table.tHead.rows] : [null, table.tHead.rows[0]];
  const groups = above ? [...above.cells].flatMap((cell) => Array(cell.colSpan).fill(cell.textContent.trim())) : [];
  const headings = [...line.cells].map((cell, k) =>
    ({ group: groups[k] ?? "", text: cell.textContent.trim(), words: cell.classList.contains("words") }));
  const rows = [...table.tBodies[0].rows].filter((row) => row.offsetParent !== null);
  return { caption: table.caption.textContent.trim(), headings, rows: rows.map((row) => [...row.cells].map(readCell)) };
}

function readCell(cell) {
  const copied = cell.cloneNode(true);
  for (const node of copied.querySelectorAll(".hidden, sup")) node.remove();
  const take = (selector) => [...copied.querySelectorAll(selector)].map((node) => {
    node.remove();
    return node.textContent.trim();
  });
  const [spreads, rest] = [take(".spread"), take("small")];
  const spread = spreads.find((text) => text.startsWith("±")) ?? "";
  return { text: copied.textContent.trim().replace(/\s+/g, " "), spread: spread.slice(1).trim(),
    rest: [...spreads.filter((text) => text !== spread), ...rest].join(", "),
    best: cell.classList.contains("best"), gap: cell.classList.contains("gap") };
}

const whole = (cell) => [cell.text + (cell.spread ? ` ± ${cell.spread}` : ""), cell.rest].filter(Boolean).join(" ");

const exporters = {
  /** A spread has a column of its own, and a gap is empty, so that every number can be read. */
  CSV({ headings, rows }) {
    const spread = headings.map((_, k) => rows.some((row) => row[k].spread));
    const names = headings.map(({ group, text }) => (group ? `${group}: ${text}` : text));
    const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const lines = [names.flatMap((name, k) => (spread[k] ? [name, `${name} ±`] : [name])), ...rows.map((row) =>
      row.flatMap((cell, k) => {
        const text = cell.gap ? "" : [cell.text, cell.rest].filter(Boolean).join(" ");
        return spread[k] ? [text, cell.spread] : [text];
      }))];
    return lines.map((line) => line.map(quoted).join(",")).join("\n") + "\n";
  },

  /** For the package booktabs. */
  LaTeX({ caption, headings, rows }) {
    const signs = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}", "δ": "$\\delta$", "Δ": "$\\Delta$",
      "↑": "$\\uparrow$", "↓": "$\\downarrow$", "±": "$\\pm$", "≥": "$\\geq$", "≤": "$\\leq$", "–": "--", "−": "$-$", "·": "$\\cdot$",
      "†": "$\\dagger$", "‡": "$\\ddagger$", "§": "\\S{}", "¶": "\\P{}", "◊": "$\\Diamond$", "Â": "$\\hat{A}$", "F̂": "$\\hat{F}$" };
    const tex = (text) => text.replace(/δ_(\w)/g, "\u0001$1").replace(/F̂|[\\~^δΔ↑↓±≥≤–−·†‡§¶◊Â]|[#$%&_{}]/g,
      (sign) => signs[sign] ?? `\\${sign}`).replace(/\u0001(\w)/g, "$$\\delta_$1$$");
    const line = (cells) => `${cells.join(" & ")} \\\\`;
    const above = [], rules = [];
    for (let k = 0, end; k < headings.length; k = end) {
      for (end = k + 1; end < headings.length && headings[end].group === headings[k].group;) end++;
      const { group } = headings[k];
      above.push(group || end - k > 1 ? `\\multicolumn{${end - k}}{c}{${tex(group)}}` : "");
      if (group) rules.push(`\\cmidrule(lr){${k + 1}-${end}}`);
    }
    return [`% ${caption}`, `\\begin{tabular}{${headings.map(({ words }) => (words ? "l" : "r")).join("")}}`, "\\toprule",
      ...(rules.length ? [line(above), rules.join(" ")] : []), line(headings.map(({ text }) => tex(text))), "\\midrule",
      ...rows.map((row) => line(row.map((cell) => (cell.best ? `\\textbf{${tex(whole(cell))}}` : tex(whole(cell)))))),
      "\\bottomrule", "\\end{tabular}", ""].join("\n");
  },

  Markdown({ headings, rows }) {
    const literal = (text) => text.replace(/[\\|*_`<]/g, "\\$&");
    const line = (cells) => `| ${cells.join(" | ")} |`;
    return [line(headings.map(({ group, text }) => literal(group ? `${group}: ${text}` : text))),
      line(headings.map(({ words }) => (words ? ":---" : "---:"))),
      ...rows.map((row) => line(row.map((cell) => (cell.best ? `**${literal(whole(cell))}**` : literal(whole(cell)))))), ""].join("\n");
  },
};

/** Into the clipboard; where the browser refuses that, as a file. */
async function copy(text, format, caption) {
  try {
    await navigator.clipboard.writeText(text);
    page.notice(`Copied as ${format}: ${caption}`);
  } catch {
    const suffix = { CSV: "csv", LaTeX: "tex", Markdown: "md" }[format];
    const link = page.make("a", { href: URL.createObjectURL(new Blob([text])), download: `${caption.replace(/[^\w.-]+/g, "_")}.${suffix}` });
    link.click();
    page.notice(`Saved as ${link.download}`);
  }
}
