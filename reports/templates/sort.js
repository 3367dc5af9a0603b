// Tables that sort by a click on a heading: numbers as numbers, and what has no number last, whichever way.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const headings = [...table.tHead.rows].at(-1).cells;
  [...headings].forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const before = heading.getAttribute("aria-sort");
      const order = before ? (before === "ascending" ? "descending" : "ascending") : heading.dataset.first;
      for (const other of headings) other.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", order);
      const sign = order === "ascending" ? 1 : -1;
      const rows = [...body.rows].map((row, index) => ({ row, index, key: sortKey(row.cells[column]) }));
      rows.sort((one, other) => {
        if (one.key === null || other.key === null) return (one.key === null) - (other.key === null) || one.index - other.index;
        return sign * compareKeys(one.key, other.key) || one.index - other.index;
      });
      body.append(...rows.map((entry) => entry.row));
      page.say(`Sorted by ${heading.textContent.trim()}, ${order}`);
    });
  });
}

function sortKey(cell) {
  const text = cell.dataset.sort;
  if (text === undefined) return null;
  return cell.classList.contains("number") || /^-?[\d.]+$/.test(text) ? Number(text) : text;
}

function compareKeys(one, other) {
  if (typeof one === "number" && typeof other === "number") return one < other ? -1 : one > other ? 1 : 0;
  return String(one).localeCompare(String(other), "en", { numeric: true });
}
