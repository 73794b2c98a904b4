// A link of the table of contents opens the part that it leads to.
document.querySelectorAll("nav a").forEach((link) => link.addEventListener("click", () => {
  const part = document.querySelector(`${link.getAttribute("href")} > details`);
  if (part) part.open = true;
}));
// On a narrow screen, style.css shows each row of a stacked table as a list, in which every cell has its heading.
document.querySelectorAll("table.stackable").forEach((table) => {
  const headings = [...table.tHead.rows[0].cells].map((cell) => cell.textContent);
  [...table.tBodies[0].rows].forEach((row) => [...row.cells].forEach((cell, i) => { cell.dataset.label = headings[i]; }));
  table.classList.add("stacked");
});
