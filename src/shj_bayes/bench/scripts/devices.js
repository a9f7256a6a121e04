/* Devices and sets: arranged by dragging or from lists; checked, fitted and diagnosed. */
"use strict";
(() => {
  const CONNECTION = [["bolts", "bolts", "number"], ["bolt_mm", "bolt diameter (mm)", "number"], ["bolt_grade", "bolt grade", "text"], ["surfaces", "sliding surfaces of a bolt (2 where left out)", "number"], ["clamping_kN", "clamping of a bolt (kN)", "number"], ["slot_mm", "slot length (mm)", "number"], ["shim", "shim, such as Bisalloy 500", "text"], ["finish", "its surface, such as mill scale", "text"]];
  let dragged = null;

  const nameOf = (id) => bench.state.files.find((file) => file.id === id)?.name ?? id;
  const plan = () => bench.state.sets.map((group) => ({ id: group.id, name: group.name, devices: group.devices.map(({ id, name, files }) => ({ id, name, files: [...files] })) }));
  const send = async (sets, words) => {
    const state = await bench.ask("/api/sets", "PUT", { sets });
    if (state) {
      bench.take(state);
      if (words) bench.say(words);
    } else await bench.load();
  };
  const without = (sets, { file, device }) => {
    let taken = null;
    for (const group of sets) {
      for (const one of group.devices) {
        if (file && one.files.includes(file)) one.files = one.files.filter((id) => id !== file);
      }
      if (device) {
        taken = group.devices.find((one) => one.id === device) ?? taken;
        group.devices = group.devices.filter((one) => one.id !== device);
      }
    }
    return taken;
  };
  const moveFile = (file, device) => {
    const sets = plan();
    without(sets, { file });
    const target = sets.flatMap((group) => group.devices).find((one) => one.id === device);
    if (target) target.files.push(file);
    else sets.find((group) => group.id === device)?.devices.push({ name: nameOf(file).replace(/\.[^.]*$/, ""), files: [file] });
    send(sets, `${nameOf(file)} was moved.`);
  };
  const moveDevice = (device, group) => {
    const sets = plan();
    const taken = without(sets, { device });
    sets.find((one) => one.id === group).devices.push(taken);
    send(sets, `${taken.name} was moved.`);
  };
  const shift = (device, file, by) => {
    const sets = plan();
    const { files } = sets.flatMap((group) => group.devices).find((one) => one.id === device);
    const i = files.indexOf(file);
    files.splice(i, 1);
    files.splice(i + by, 0, file);
    send(sets, `${nameOf(file)} is run ${i + by + 1} now.`);
  };

  const draggable = (node, what) => {
    node.draggable = true;
    node.addEventListener("dragstart", (event) => {
      event.stopPropagation();
      dragged = what;
      event.dataTransfer.setData("text/plain", "");
      node.classList.add("dragged");
    });
    node.addEventListener("dragend", () => node.classList.remove("dragged"));
    return node;
  };
  const target = (node, accepts, act) => {
    node.addEventListener("dragover", (event) => {
      if (!dragged || !accepts(dragged)) return;
      event.preventDefault();
      event.stopPropagation();
      node.classList.add("over");
    });
    node.addEventListener("dragleave", () => node.classList.remove("over"));
    node.addEventListener("drop", (event) => {
      if (!dragged || !accepts(dragged)) return;
      event.preventDefault();
      event.stopPropagation();
      const what = dragged;
      dragged = null;
      act(what);
    });
    return node;
  };
  const renamed = (value, words, change) => el("input", { value, "aria-label": words, onchange: (event) => change(event.target.value) });
  const rename = (id, name) => {
    const sets = plan();
    const one = sets.flatMap((group) => [group, ...group.devices]).find((entry) => entry.id === id);
    one.name = name;
    send(sets, `Renamed to ${name}.`);
  };
  const note = (device) => el("label", {}, "Note, for the report", el("textarea", { rows: 2, cols: 40, onchange: async (event) => {
    const state = await bench.ask(`/api/devices/${device.id}/about`, "PUT", { note: event.target.value });
    if (state) { bench.take(state); bench.say(`The note on ${device.name} was kept.`); }
  } }, device.note));

  const READING = ["columns", "units", "rate_Hz", "sheet", "runs"];
  const OPTIONS = { model: ["published", "continuous"], noise: ["slow", "ar1", "independent", "student"], priors: ["afc", "general"] };
  const options = (device) => {
    const fields = Object.entries(OPTIONS).map(([name, words]) => el("label", {}, bench.term(name === "noise" ? "noise model" : name, name), el("select", { name }, ...words.map((word) => el("option", { value: word, selected: (device.options[name] ?? words[0]) === word }, word)))));
    const form = el("form", { class: "fields" }, ...fields, el("button", { type: "submit" }, "Keep"));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const chosen = Object.fromEntries([...new FormData(form)].filter(([name, word]) => word !== OPTIONS[name][0]));
      const reading = Object.fromEntries(Object.entries(device.options).filter(([name]) => READING.includes(name)));
      const state = await bench.ask(`/api/devices/${device.id}/about`, "PUT", { options: { ...reading, ...chosen } });
      if (state) { bench.take(state); bench.say(`The options of ${device.name} were kept: check it again.`); }
    });
    return el("details", {}, el("summary", {}, "Options of the fit"), form);
  };
  const fileItem = (device, file, i) => {
    const choice = el("select", { "aria-label": `move ${nameOf(file)} to` }, el("option", { value: "" }, "move to ..."), ...bench.devices().filter((one) => one.id !== device.id).map((one) => el("option", { value: one.id }, `${one.group.name}: ${one.name}`)), ...bench.state.sets.map((group) => el("option", { value: group.id }, `${group.name}: a device of its own`)));
    choice.addEventListener("change", () => choice.value && moveFile(file, choice.value));
    const button = (words, name, by, off) => el("button", { type: "button", "aria-label": `${name}: ${nameOf(file)}`, disabled: off, onclick: () => shift(device.id, file, by) }, words);
    const order = device.id ? [button("↑", "earlier run", -1, i === 0), button("↓", "later run", 1, i === device.files.length - 1)] : [];
    return draggable(el("li", {}, nameOf(file), " ", ...order, " ", choice), { file });
  };
  const deviceItem = (group, device) => {
    const choice = el("select", { "aria-label": `move ${device.name} to` }, el("option", { value: "" }, "move to ..."), ...bench.state.sets.filter((one) => one.id !== group.id).map((one) => el("option", { value: one.id }, one.name)));
    choice.addEventListener("change", () => choice.value && moveDevice(device.id, choice.value));
    const item = el("div", { class: "device-item" }, renamed(device.name, `name of device ${device.name}`, (name) => rename(device.id, name)), " ", bench.state.sets.length > 1 ? choice : "", el("ol", {}, ...device.files.map((file, i) => fileItem(device, file, i))), options(device), el("details", {}, el("summary", {}, "Note"), note(device)));
    return target(draggable(item, { device: device.id }), (what) => what.file && !device.files.includes(what.file), (what) => moveFile(what.file, device.id));
  };
  const connection = (group) => {
    const fields = CONNECTION.map(([name, words, type]) => el("label", {}, words, el("input", { name, type, step: "any", min: "0", value: group.connection[name] ?? "" })));
    const place = el("select", { name: "displacement" }, ...[["", "not said"], ["device", "across the sliding surfaces"], ["machine", "at the machine, with grips and frame"]].map(([value, words]) => el("option", { value, selected: (group.connection.displacement ?? "") === value }, words)));
    const note = el("textarea", { name: "note", rows: 2, cols: 40 }, group.note);
    const others = bench.state.sets.filter((one) => one.id !== group.id && Object.keys(one.connection).length);
    const copy = el("select", { "aria-label": `take the connection of another set for ${group.name}`, onchange: () => {
      const from = others.find((one) => one.id === copy.value);
      for (const field of form.elements) if (from && field.name in { ...from.connection }) field.value = from.connection[field.name];
    } }, el("option", { value: "" }, "as in another set ..."), ...others.map((one) => el("option", { value: one.id }, one.name)));
    const form = el("form", { class: "fields" }, ...fields, el("label", {}, "displacement measured", place), ...(others.length ? [el("label", {}, "take over", copy)] : []), el("label", {}, "note, for the report", note), el("button", { type: "submit" }, "Keep connection and note"));
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const { note: words, ...said } = Object.fromEntries(new FormData(form));
      document.activeElement.blur();
      const state = await bench.ask(`/api/sets/${group.id}/about`, "PUT", { connection: said, note: words });
      if (state) { bench.take(state); bench.say(`The connection of ${group.name} and its note were kept.`); }
    });
    return el("details", {}, el("summary", {}, "One connection as tested: bolts, clamping, slot; note"), form);
  };
  const cards = () => {
    if (at("sets").hidden) return;
    const typed = [...document.querySelectorAll("#set-cards :is(input, textarea)")].find((field) => field === document.activeElement && field.value !== field.defaultValue);
    if (typed) {
      /* What is being typed stays; the cards are drawn when it is done. */
      typed.addEventListener("blur", () => setTimeout(cards, 300), { once: true });
      return;
    }
    if (!bench.state.files.length) {
      at("set-cards").replaceChildren(el("p", {}, "No devices yet: drop recordings in the first step."));
      return;
    }
    const open = new Set([...document.querySelectorAll("#set-cards details[open]")].map((node) => node.closest("[data-id]").dataset.id));
    const used = new Set(bench.devices().flatMap((device) => device.files));
    const loose = bench.state.files.filter(({ id }) => !used.has(id));
    const without = loose.length ? [el("div", { class: "set-card" }, el("strong", {}, "Files without a device"), el("ol", {}, ...loose.map(({ id }, i) => fileItem({ id: "", files: [] }, id, i))))] : [];
    at("set-cards").replaceChildren(...without, ...bench.state.sets.map((group) => {
      const card = el("div", { class: "set-card", "data-id": group.id }, el("strong", {}, "Set "), renamed(group.name, `name of set ${group.name}`, (name) => rename(group.id, name)), el("span", { class: "more" }, ` ${group.devices.length} ${group.devices.length === 1 ? "device" : "devices"}`), ...group.devices.map((device) => deviceItem(group, device)), connection(group));
      if (open.has(group.id)) card.lastChild.open = true;
      return target(card, (what) => !(what.device && group.devices.some((one) => one.id === what.device)), (what) => (what.device ? moveDevice(what.device, group.id) : moveFile(what.file, group.id)));
    }));
  };
  bench.shown.push(cards);
  at("new-set").addEventListener("click", () => {
    const last = bench.devices().at(-1);
    if (!last) return;
    const sets = plan();
    const names = new Set(sets.map((group) => group.name));
    let n = 1;
    while (names.has(`Set ${n}`)) n += 1;
    const taken = without(sets, { device: last.id });
    sets.push({ name: `Set ${n}`, devices: [taken] });
    send(sets, `Set ${n} begins with ${taken.name}; move it back, or others to it.`);
  });

  /* Check and fit */
  const VERDICT = { reliable: "good", tentative: "fair", unusable: "bad" };
  const checks = new Map();
  let chosen = null;

  const checkCell = (device) => {
    const passed = checks.get(device.id)?.passed ?? device.passed;
    if (passed === null || passed === undefined) return "";
    return el("span", { class: passed ? "good" : "bad" }, passed ? "passed" : "not passed");
  };
  const rows = () => {
    if (at("fit").hidden) return;
    const devices = bench.devices();
    at("device-rows").replaceChildren(...devices.map((device) => {
      const job = bench.jobOf("fit", device.id);
      const bar = job ? el("div", {}, bench.bar(job)) : "";
      const fit = el("span", { class: VERDICT[device.fit] ?? "" }, device.fit ?? "");
      return el("tr", { class: device.id === chosen ? "chosen" : "" }, el("th", {}, el("button", { type: "button", onclick: () => look(device.id) }, device.name), el("span", { class: "more" }, device.group.name), bar), el("td", {}, checkCell(device)), el("td", {}, fit), el("td", {}, device.diagnosis ?? ""));
    }));
    at("fit-all").disabled = !devices.some((device) => !device.fit);
    at("fit-all").textContent = `Check and fit all ${devices.filter((device) => !device.fit).length || ""}`.trim();
    if (chosen === null && devices.length) pick(devices[0].id);
    else if (chosen !== null) results();
  };
  bench.shown.push(rows);

  const pick = async (id) => {
    chosen = id;
    rows();
    const device = bench.devices().find((one) => one.id === id);
    at("device-detail").replaceChildren(el("h2", {}, device.name), el("p", {}, "Checking what these recordings can tell ..."));
    const found = await bench.ask(`/api/devices/${id}/check`);
    if (!found) {
      at("device-detail").replaceChildren(el("h2", {}, device.name), el("p", { class: "note" }, at("said").textContent));
      return;
    }
    checks.set(id, found);
    if (chosen !== id) return;
    detail(device, found);
    rows();
  };

  /* Chosen by hand: where the result stands below the list, go to it. */
  const look = async (id) => {
    await pick(id);
    if (innerWidth < 960) at("device-detail").scrollIntoView();
  };

  const detail = (device, found) => {
    const parts = [el("h2", {}, device.name), el("div", { id: "fit-bar" }), el("div", { id: "fit-result" })];
    if (found.viewer) parts.push(bench.loops(found.viewer));
    for (const line of found.warnings ?? []) parts.push(el("p", { class: "note" }, line));
    if (found.rows.length) {
      parts.push(el("p", {}, el("strong", {}, found.headline)), el("p", {}, `First answer: the most probable parameters, with the intervals that a fit will give, about: the scatter of this test alone, not of devices or of the load cell's calibration. The law leaves ${found.rmse} (root mean square) of the force.`));
      parts.push(bench.table("What this recording tells: width is the interval after the test over that before it", ["Parameter", "Value", "90 % interval", "Before the test", "Width"], found.rows.map((row) => [bench.term(row.name), `${row.value} ${row.unit}`, `${row.expected} ${row.unit}`, `${row.before} ${row.unit}`, row.narrowed])));
    }
    if (found.lines.length) parts.push(bench.lines(found.lines));
    if (found.confusions?.length) {
      parts.push(el("details", {}, el("summary", {}, `What this displacement history cannot tell apart (${found.confusions.length})`), bench.table("The cheapest test that would tell", ["One", "The other", "Alike to", "Test"], found.confusions.map((one) => [one.first, one.second, one.alike, one.test]))));
    }
    at("device-detail").replaceChildren(...parts);
    results();
  };

  const results = () => {
    const device = bench.devices().find((one) => one.id === chosen);
    const bar = at("fit-bar");
    const result = at("fit-result");
    if (!device || !bar || !result) return;
    const found = checks.get(chosen);
    const job = bench.jobOf("fit", chosen);
    const button = el("button", { type: "button", class: "main", disabled: !found?.passed || Boolean(job), onclick: () => begin(chosen) }, device.fit ? "Fitted and diagnosed" : "Fit and diagnose");
    if (device.fit && !job) button.disabled = true;
    bar.replaceChildren(...(job ? [bench.bar(job)] : [button, " ", ...(found?.passed === false ? [el("span", { class: "bad" }, `Not passed: ${found.reasons.join(" ")}`)] : [])]));
    const key = JSON.stringify([device.fit, device.diagnosis, device.pages, device.numbers]);
    if (result.dataset.key === key) return;
    result.dataset.key = key;
    if (!device.fit) {
      result.replaceChildren();
      return;
    }
    const frame = el("div", {});
    const tabs = el("div", { class: "tabs" }, ...device.pages.map((name) => el("button", { type: "button", onclick: () => bench.inside(frame, bench.page(device.id, name, `${name} of ${device.name}`)) }, { report: "Report", diagnosis: "Diagnosis", plan: "Next test" }[name])));
    result.replaceChildren(el("p", {}, el("span", { class: `badge ${device.fit}` }, device.fit), ` ${device.left}`), bench.table("Median and 90 % interval", ["Parameter", "Value", "90 % interval"], device.numbers.map((row) => [bench.term(row.name), `${row.value} ${row.unit === "1" ? "" : row.unit}`, row.interval])), el("p", {}, "What the law leaves out: ", el("strong", {}, device.diagnosis || "not diagnosed")), tabs, frame, bench.again(bench.state.command));
  };

  const begin = async (id) => {
    const job = await bench.ask(`/api/devices/${id}/fit`, "POST");
    if (job) {
      bench.jobs.set(job.id, job);
      bench.say(`${bench.devices().find((one) => one.id === id).name} is fitted; you can go on meanwhile.`);
      rows();
    }
  };
  at("fit-all").addEventListener("click", async () => {
    const waiting = bench.devices().filter((device) => !device.fit && !bench.jobOf("fit", device.id));
    let begun = 0;
    for (const device of waiting) {
      bench.say(`Checking ${device.name} (${begun + 1} of ${waiting.length})`);
      const found = await bench.ask(`/api/devices/${device.id}/check`, "GET", undefined, true);
      if (found && !found.refused) checks.set(device.id, found);
      if (!found?.passed) continue;
      const job = await bench.ask(`/api/devices/${device.id}/fit`, "POST");
      if (job) { bench.jobs.set(job.id, job); begun += 1; }
      rows();
    }
    bench.say(`${begun} of ${waiting.length} ${waiting.length === 1 ? "device is" : "devices are"} being fitted${begun < waiting.length ? "; the others have not passed their check" : ""}. You can go on meanwhile.`, begun < waiting.length);
  });
  bench.onJob = (job) => {
    if (job.kind === "fit") rows();
    if (job.kind === "fit" && job.state === "done" && ![...bench.jobs.values()].some((one) => one.kind === "fit" && ["waiting", "running"].includes(one.state))) bench.say("All fits are done. Next: compare and design.");
    bench.onLongJob?.(job);
  };
})();
