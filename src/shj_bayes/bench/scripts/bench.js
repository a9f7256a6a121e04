/* What all parts of the bench share: asking the server, what is said, steps, progress, and the words explained. */
"use strict";
const bench = { state: { sets: [], files: [], jobs: [], pages: [] }, jobs: new Map(), glossary: JSON.parse(document.getElementById("glossary").textContent), shown: [] };
const at = (id) => document.getElementById(id);

bench.say = (words, bad = false) => {
  at("said").textContent = words;
  at("said").classList.toggle("bad", bad);
};

/* Ask the server; a refusal, which it tells in words, is said, and given as null. */
bench.ask = async (path, method = "GET", content = undefined, quiet = false) => {
  const raw = content instanceof Blob;
  const body = content === undefined || raw ? content : JSON.stringify(content);
  try {
    const answer = await fetch(path, { method, body, headers: body && !raw ? { "Content-Type": "application/json" } : {} });
    const said = await answer.json();
    if (said.refused === undefined || quiet) return said;
    bench.say(said.refused, true);
    return null;
  } catch {
    bench.say("The bench does not answer. If it was ended, begin it again by its command: everything that was finished is kept.", true);
    return null;
  }
};

bench.load = async () => {
  const state = await bench.ask("/api/state");
  if (state) bench.take(state);
};

bench.take = (state) => {
  bench.state = state;
  for (const job of state.jobs) bench.jobs.set(job.id, job);
  if (state.error) bench.say(state.error, true);
  at("command").textContent = state.command;
  for (const show of bench.shown) show();
};

bench.devices = () => bench.state.sets.flatMap((group) => group.devices.map((device) => ({ ...device, group })));
bench.jobOf = (kind, target) => [...bench.jobs.values()].reverse().find((job) => job.kind === kind && job.target === target && ["waiting", "running"].includes(job.state));

/* A bar with words and a button that ends the job. */
bench.bar = (job) => el("span", { "data-job": job.id }, el("progress", { max: 1, ...(job.share === null ? {} : { value: job.share }), "aria-label": "progress" }), ` ${job.share === null ? "" : `${Math.round(100 * job.share)} %, `}${job.words} `, el("button", { type: "button", onclick: () => bench.ask(`/api/jobs/${job.id}`, "DELETE") }, "Cancel"));

/* A word of the glossary, explained where it stands. */
bench.term = (word, shown = word) => (bench.glossary[word] ? el("span", { class: "term", "data-term": word, tabindex: "0" }, shown) : shown);
const explain = (event) => {
  const box = at("meaning");
  const node = event.target.closest?.("[data-term]");
  if (!node || !bench.glossary[node.dataset.term]) {
    box.hidden = true;
    return;
  }
  box.textContent = bench.glossary[node.dataset.term];
  box.hidden = false;
  const place = node.getBoundingClientRect();
  box.style.left = `${Math.max(8, Math.min(place.left, innerWidth - box.offsetWidth - 12)) + scrollX}px`;
  box.style.top = `${place.bottom + scrollY + 4}px`;
};
for (const kind of ["mouseover", "focusin"]) document.addEventListener(kind, explain);
document.addEventListener("keydown", (event) => { if (event.key === "Escape") at("meaning").hidden = true; });
for (const node of document.querySelectorAll(".term")) node.tabIndex = 0;

bench.loops = (viewer) => {
  const box = el("div", { class: "viewer" });
  requestAnimationFrame(() => window.showLoops(box, viewer));
  return box;
};
bench.lines = (lines, kind = "") => el("ul", {}, ...lines.map((line) => el("li", { class: kind }, line)));
bench.again = (command) => el("details", {}, el("summary", {}, "The same by the command line"), el("code", { class: "again" }, command));
bench.table = (caption, heads, rows) => el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, el("table", {}, el("caption", {}, caption), el("thead", {}, el("tr", {}, ...heads.map((head) => el("th", {}, head)))), el("tbody", {}, ...rows.map((row) => el("tr", {}, ...row.map((cell, i) => el(i ? "td" : "th", {}, cell)))))));
bench.page = (of, name, title) => [el("p", {}, el("a", { href: `/page/${of}/${name}`, target: "_blank", rel: "noopener" }, "Open it in a tab of its own")), el("iframe", { class: "page", src: `/page/${of}/${name}`, title })];
bench.inside = (frame, nodes) => {
  frame.replaceChildren(...nodes);
  frame.scrollIntoView();
};

/* The step that the address names is shown. */
const step = () => {
  const wanted = location.hash.slice(1) || "files";
  for (const section of document.querySelectorAll("main > section")) section.hidden = section.id !== wanted;
  for (const link of at("steps").querySelectorAll("a")) {
    if (link.hash === `#${wanted}`) link.setAttribute("aria-current", "step");
    else link.removeAttribute("aria-current");
  }
  for (const show of bench.shown) show();
};
addEventListener("hashchange", () => { bench.say(""); step(); });
bench.open = (id) => { location.hash = `#${id}`; };

/* What changes is told by the server; after a while without it, everything is asked for again. */
let pending = 0;
bench.later = () => {
  clearTimeout(pending);
  pending = setTimeout(bench.load, 60);
};
const listen = () => {
  const source = new EventSource("/api/events");
  source.addEventListener("job", (event) => {
    const job = JSON.parse(event.data);
    bench.jobs.set(job.id, job);
    if (job.state === "failed") bench.say(`${job.kind}: ${job.words}`, true);
    bench.onJob?.(job);
    for (const bar of document.querySelectorAll(`[data-job="${job.id}"]`)) {
      if (["waiting", "running"].includes(job.state)) bar.replaceWith(bench.bar(job));
    }
  });
  source.addEventListener("changed", bench.later);
  source.addEventListener("ended", () => {
    source.close();
    bench.say("The bench was ended. Begin it again by its command: everything that was finished is kept.", true);
  });
  source.addEventListener("open", bench.later);
};
addEventListener("DOMContentLoaded", () => {
  step();
  listen();
});
