// A click on the head of a column sorts its table: numbers by size, other cells by letter, a second click in reverse.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  if (body.rows.length < 2) continue;
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const way = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", way === 1 ? "ascending" : "descending");
      const key = row => {
        const text = row.cells[column].dataset.order ?? row.cells[column].textContent.trim();
        const value = text.replace(/\u2212/g, "-").replace("·10^", "e").replace(/^\+/, "");
        return /^-?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?( |$)/.test(value) ? parseFloat(value) : text;
      };
      const compare = (a, b) => {
        const [x, y] = [key(a), key(b)], numbers = [x, y].map(one => typeof one === "number");
        if (numbers[0] && numbers[1]) return way * (x - y);
        if (numbers[0] !== numbers[1]) return numbers[0] ? -1 : 1;  // what is no number comes last
        return way * x.localeCompare(y);
      };
      body.append(...[...body.rows].sort(compare));
    });
  });
}
