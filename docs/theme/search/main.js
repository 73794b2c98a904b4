// Search in place of mkdocs' own, which needs a web worker and requests: browsers refuse both for pages opened from disk.

const LEAST_LETTERS = 3;
const SUMMARY_LETTERS = 200;
let loaded = null; // promise of { index, sections }, from the first search on

function loadScript(name) {
  return new Promise((done, failed) => {
    const script = document.createElement("script");
    script.src = `${base_url}/search/${name}`;
    script.onload = done;
    script.onerror = failed;
    document.head.append(script);
  });
}

async function load() {
  await Promise.all([loadScript("lunr.js"), loadScript("search_index.js")]);
  const titles = new Map(search_index.docs.map(({ location, title }) => [location, title]));
  const sections = new Map();
  for (const { location, title, text } of search_index.docs) {
    const [page, anchor] = location.split("#");
    if (!anchor) continue; // a whole page, whose text its sections have
    const heading = titles.get(page) === title ? title : `${titles.get(page)}: ${title}`;
    sections.set(location, { location, title: heading, text });
  }
  const index = lunr(function () {
    this.field("title", { boost: 10 });
    this.field("text");
    this.ref("location");
    sections.forEach((section) => this.add(section));
  });
  return { index, sections };
}

// Sections with these words, or with words that begin like them, best first.
function find({ index, sections }, text) {
  const found = index.query((query) => {
    for (const word of lunr.tokenizer(text)) {
      query.term(word.toString(), { boost: 10 });
      query.term(word.toString(), { usePipeline: false, wildcard: lunr.Query.wildcard.TRAILING });
    }
  });
  return found.map((result) => sections.get(result.ref));
}

function show(list, sections) {
  list.replaceChildren();
  if (!sections.length) list.append(list.dataset.noResultsText);
  for (const section of sections) {
    const article = list.appendChild(document.createElement("article"));
    const link = article.appendChild(document.createElement("h3")).appendChild(document.createElement("a"));
    link.href = `${base_url}/${section.location}`;
    link.textContent = section.title;
    article.appendChild(document.createElement("p")).textContent = section.text.slice(0, SUMMARY_LETTERS);
  }
}

// The field and the list of results come after this script in the page.
document.addEventListener("DOMContentLoaded", () => {
  const field = document.getElementById("mkdocs-search-query");
  const list = document.getElementById("mkdocs-search-results");
  field.addEventListener("input", async () => {
    const text = field.value.trim();
    loaded ??= load();
    const site = await loaded;
    if (text === field.value.trim()) show(list, text.length < LEAST_LETTERS ? [] : find(site, text));
  });
  field.form.addEventListener("submit", (event) => event.preventDefault());
});
