// The head of a column sorts the rows of a table by it: numbers by value, what is empty last; once more, the other way.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  const value = (row, k) => row.cells[k].textContent.trim();
  heads.forEach((head, k) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.ariaSort !== "ascending";
      const numbers = head.classList.contains("number");
      const order = (a, b) => numbers ? parseFloat(a) - parseFloat(b) : a.localeCompare(b, "en", { numeric: true });
      const rows = [...table.tBodies[0].rows].sort((a, b) => {
        const [p, q] = [value(a, k), value(b, k)];
        return p === "" || q === "" ? (p === "") - (q === "") : up ? order(p, q) : order(q, p);
      });
      table.tBodies[0].append(...rows);
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
    });
  });
}
