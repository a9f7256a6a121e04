/* Recordings: dropped or chosen, read at once, columns and units chosen where they are not known. */
"use strict";
(() => {
  const UNITS = { time: ["s", "ms", "min"], displacement: ["mm", "cm", "m", "um", "in"], force: ["kN", "N", "MN", "kgf", "tf", "lbf", "kip"] };
  const ROLES = Object.keys(UNITS);
  const known = new Map();
  let chosen = null;

  const deviceOf = (id) => bench.devices().find((device) => device.files.includes(id));
  const stateOf = (id) => {
    const found = known.get(id);
    if (!found) return el("span", {}, "");
    if (found.error) return el("span", { class: "bad" }, found.columns.length ? "columns or units?" : "cannot be read");
    return el("span", { class: found.usable ? "good" : "bad" }, found.usable ? "usable" : "cannot be used");
  };

  const rows = () => {
    at("file-rows").replaceChildren(...bench.state.files.map(({ id, name }) => el("tr", { class: id === chosen ? "chosen" : "" },
      el("th", {}, el("button", { type: "button", onclick: () => pick(id) }, name)),
      el("td", {}, deviceOf(id)?.name ?? "none"),
      el("td", {}, stateOf(id)))));
    at("learn").open = !bench.state.files.length;
    at("drop").classList.toggle("small", bench.state.files.length > 0);
  };
  bench.shown.push(rows);

  const pick = async (id) => {
    chosen = id;
    rows();
    const found = await bench.ask(`/api/files/${id}`);
    if (!found || chosen !== id) return;
    known.set(id, found);
    rows();
    show(found);
  };

  const show = (found) => {
    const parts = [el("h2", {}, found.name)];
    if (found.error) parts.push(el("p", { class: "note" }, found.error));
    if (found.viewer) parts.push(bench.loops(found.viewer));
    const said = found.runs.flatMap((run) => run.findings.map((f) => [f.severity, f.message]));
    if (said.length) parts.push(bench.table("What was found, assumed and repaired", ["Kind", "What"], said));
    else if (!found.error) parts.push(el("p", {}, "Nothing to remark."));
    if (found.text) parts.push(el("details", {}, el("summary", {}, "All that was read"), el("pre", {}, found.text)));
    parts.push(columns(found));
    if (found.command) parts.push(bench.again(found.command));
    parts.push(el("p", {}, el("button", { type: "button", onclick: () => remove(found) }, "Take this file out of the folder")));
    at("file-detail").replaceChildren(...parts);
  };

  const remove = async (found) => {
    if (await bench.ask(`/api/files/${found.id}`, "DELETE")) {
      known.delete(found.id);
      chosen = null;
      at("file-detail").replaceChildren();
      bench.say(`${found.name} was taken out.`);
    }
  };

  /* Columns and units from lists, beside the first rows of the file. */
  const columns = (found) => {
    const before = Object.fromEntries((found.options.columns ?? "").split(",").filter(Boolean).map((part) => part.split("=")));
    const units = Object.fromEntries((found.options.units ?? "").split(",").filter(Boolean).map((part) => part.split("=")));
    const fields = ROLES.map((role) => {
      const which = el("select", { name: role }, el("option", { value: "" }, "as the file says"), ...found.columns.map((head, i) => el("option", { value: i + 1, selected: String(i + 1) === before[role] }, `${i + 1}: ${head || "(no name)"}`)));
      const unit = el("select", { name: `${role}-unit`, "aria-label": `unit of ${role}` }, el("option", { value: "" }, "unit as the file says"), ...UNITS[role].map((word) => el("option", { value: word, selected: word === units[role] }, word)));
      return el("label", {}, role, which, unit);
    });
    const rate = el("input", { name: "rate", type: "number", min: "0", step: "any", value: found.options.rate_Hz ?? "" });
    const runs = el("select", { name: "runs" }, ...[["", "as it looks"], ["one", "one run"], ["split", "several: split where they are found"]].map(([value, words]) => el("option", { value, selected: found.options.runs === value }, words)));
    const sheet = el("input", { name: "sheet", value: found.options.sheet ?? "" });
    const form = el("form", { class: "fields" }, ...(found.columns.length ? fields : []), el("label", {}, "sheet or group", sheet), el("label", {}, "rate of a file without time (Hz)", rate), el("label", {}, "runs in the file", runs), el("button", { type: "submit", class: found.error ? "main" : "" }, "Read it so"));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const data = new FormData(form);
      const pairs = (suffix) => ROLES.filter((role) => data.get(role + suffix)).map((role) => `${role}=${data.get(role + suffix)}`).join(",");
      const options = { columns: pairs(""), units: pairs("-unit"), runs: data.get("runs"), ...(data.get("rate") ? { rate_Hz: Number(data.get("rate")) } : {}), ...(data.get("sheet") ? { sheet: data.get("sheet") } : {}) };
      const again = await bench.ask(`/api/files/${found.id}`, "PUT", options);
      if (!again) return;
      known.set(found.id, again);
      bench.say(again.error ? again.error : `${again.name} was read; files of the same form will be read like it.`, Boolean(again.error));
      show(again);
      rows();
    });
    const preview = !found.columns.length ? "" : bench.table("First rows of the file", found.columns.map((head, i) => `${i + 1}: ${head}`), found.rows);
    return el("details", { open: Boolean(found.error) }, el("summary", {}, "Columns, units and runs"), form, preview);
  };

  const take = async (files) => {
    let done = 0;
    let bad = 0;
    let skipped = 0;
    for (const one of files) {
      bench.say(`Reading ${one.name} (${done + 1} of ${files.length})`);
      const found = await bench.ask(`/api/files?name=${encodeURIComponent(one.name)}`, "PUT", one, true);
      done += 1;
      if (found?.already) {
        skipped += 1;
        continue;
      }
      if (!found || found.refused) {
        bad += 1;
        bench.say(`${one.name}: ${found?.refused ?? "not taken"}`, true);
        continue;
      }
      known.set(found.id, found);
      if (files.length === 1 || done === files.length || found.error) {
        chosen = found.id;
        show(found);
      }
      if (found.error || !found.usable) bad += 1;
    }
    await bench.load();
    if (skipped && skipped === done) bench.say(`${files.length === 1 ? "This file is" : "These files are"} here already and ${files.length === 1 ? "was" : "were"} not taken again.`);
    else if (done === bad + skipped && bad) bench.say(`${bad} of ${done} ${done === 1 ? "file cannot" : "files cannot"} be used yet: the state in the list says why.`, true);
    else if (done > bad) bench.say(`${done - skipped} ${done - skipped === 1 ? "file" : "files"} read${skipped ? `, ${skipped} were here already` : ""}${bad ? `, ${bad} of them cannot be used yet: their state says why` : ""}. Next: devices and sets, or check and fit.`, bad > 0);
  };

  at("choose").addEventListener("change", (event) => take([...event.target.files]).then(() => { event.target.value = ""; }));
  for (const kind of ["dragenter", "dragover"]) {
    addEventListener(kind, (event) => {
      if (![...event.dataTransfer.types].includes("Files")) return;
      event.preventDefault();
      at("drop").classList.add("over");
    });
  }
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) at("drop").classList.remove("over"); });
  addEventListener("drop", (event) => {
    if (!event.dataTransfer.files.length) return;
    event.preventDefault();
    at("drop").classList.remove("over");
    bench.open("files");
    take([...event.dataTransfer.files]);
  });
  for (const button of document.querySelectorAll("[data-story]")) {
    button.addEventListener("click", async () => {
      const state = await bench.ask(`/api/stories/${button.dataset.story}`, "POST");
      if (!state) return;
      bench.take(state);
      bench.say("The recordings are here. Next: check and fit.");
      bench.open("fit");
    });
  }
})();
