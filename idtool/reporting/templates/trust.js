// The words of the table below on the bars above it.
(() => {
  const heads = [...document.querySelectorAll("thead.grounds th")].map((head) => head.textContent);
  const words = document.querySelectorAll("tbody.words-of");
  document.querySelectorAll("tbody.grounds tr").forEach((strip, i) => {
    const told = new Map([...words[i].rows].filter((row) => row.cells.length === 5)
      .map((row) => [row.cells[0].textContent, row.cells[4].textContent]));
    [...strip.cells].slice(1).forEach((bar, k) => {
      const name = heads[k + 1];
      bar.title = `${strip.cells[0].textContent} ${name}: ${told.get(name) || "prior only"}`;
    });
  });
})();
