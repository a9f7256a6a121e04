/* Pooling, the designer's card, two sets compared, the next test. */
"use strict";
(() => {
  const HISTORIED = ["amplitude_mm", "speed_mm_s", "cycles"];
  let history = false;
  let waiting = 0;
  let asking = false;
  let again = false;

  const bars = () => {
    for (const [kind, target, id] of [["pool", "campaign", "pool-bar"], ["margins", "margins", "margins-bar"]]) {
      const job = bench.jobOf(kind, target);
      at(id).replaceChildren(...(job ? [bench.bar(job)] : []));
    }
    const job = [...bench.jobs.values()].find((one) => one.kind === "plan" && ["waiting", "running"].includes(one.state));
    at("plan-bar").replaceChildren(...(job ? [bench.bar(job)] : []));
    at("pool").disabled = Boolean(bench.jobOf("pool", "campaign")) || !bench.devices().some((device) => device.fit);
  };
  const fill = (select, entries) => {
    const before = select.value;
    select.replaceChildren(...entries.map(([value, words]) => el("option", { value }, words)));
    if (entries.some(([value]) => value === before)) select.value = before;
  };
  const show = () => {
    if (at("design").hidden) return;
    const devices = bench.devices();
    const fitted = devices.filter((device) => device.fit);
    const open = devices.length - fitted.length;
    at("pool-state").textContent = bench.state.pooled
      ? `${fitted.length} devices of ${new Set(fitted.map((device) => device.group.id)).size} ${bench.state.sets.length === 1 ? "set" : "sets"} are pooled: what they say together holds for the next device.`
      : fitted.length
        ? `${fitted.length} of ${devices.length} devices are fitted${open ? "; the others are fitted first" : ""}.`
        : "No device is fitted yet: check and fit first.";
    if (bench.state.changed) at("pool-state").textContent += " Devices, sets or connections have changed since the margins were drawn up: compute them again.";
    at("pool").textContent = bench.state.pooled ? "Compute them again" : "Compute the design forces";
    at("designer").hidden = !bench.state.pooled;
    bars();
    if (!bench.state.pooled) return;
    const sets = bench.state.sets.map((group) => [group.id, group.name]);
    fill(at("asked").elements.set, sets);
    fill(at("compared").elements.a, sets);
    fill(at("compared").elements.b, sets);
    if (sets.length > 1 && at("compared").elements.a.value === at("compared").elements.b.value) at("compared").elements.b.value = sets.find(([id]) => id !== at("compared").elements.a.value)[0];
    fill(at("planned").elements.device, fitted.map((device) => [device.id, `${device.group.name}: ${device.name}`]));
    if (!at("report").childElementCount) pages();
    if (!at("card").childElementCount) ask();
  };
  bench.shown.push(show);

  const pages = () => {
    const frame = el("div", {});
    const titles = { report: "Report of all devices", margins: "Sheet of margins" };
    at("report").replaceChildren(el("h2", {}, "Pages"), el("div", { class: "tabs" }, ...bench.state.pages.map((name) => el("button", { type: "button", onclick: () => bench.inside(frame, bench.page("campaign", name, titles[name])) }, titles[name]))), frame);
  };

  const wanted = () => {
    const out = {};
    for (const field of at("asked").elements) {
      if (!field.name || ["set", "history"].includes(field.name) || field.value === "") continue;
      if (history && HISTORIED.includes(field.name)) continue;
      out[field.name] = field.type === "number" ? Number(field.value) : field.value;
    }
    const { storey_height: height, lever_arm: arm, ...plain } = out;
    if (!history) return arm === undefined ? plain : { ...plain, lever_arm: arm };
    return height === undefined || arm === undefined ? { ...plain, history } : { ...plain, drift: true, storey_height: height, lever_arm: arm };
  };
  const ask = async () => {
    if (asking) {
      again = true;
      return;
    }
    asking = true;
    const found = await bench.ask("/api/card", "POST", wanted(), true);
    asking = false;
    at("card-error").hidden = !found?.refused;
    at("card-error").textContent = found?.refused ?? "";
    if (found && !found.refused) draw(found);
    if (again) {
      again = false;
      ask();
    }
  };
  const draw = (found) => {
    const name = at("asked").elements.set.selectedOptions[0]?.textContent;
    const card = found.cards.find((one) => one.name === name) ?? found.cards[0];
    const shown = (value, line) => (value ? el("span", { class: line.main ? "big" : "" }, `${value}${line.unit ? ` ${line.unit}` : ""}`) : "");
    const rows = (lines) => lines.map((line) => [line.use, ...line.values.map((value) => shown(value, line)), line.clause]);
    const heads = ["Use", "For drift: lower", "Typical", "For capacity: upper", "Clause, or what it is"];
    const first = card.lines.filter((line) => line.own);
    const parts = [bench.table(`${card.name}: forces`, heads, rows(first)), el("details", {}, el("summary", {}, "By design code, and all other lines"), bench.table(`${card.name}: all lines`, heads, rows(card.lines.filter((line) => !line.own))))];
    parts.push(el("dl", {}, ...card.facts.flatMap(([head, said]) => [el("dt", {}, el("strong", {}, head)), el("dd", {}, said)])));
    if (found.warnings.length) parts.push(el("details", {}, el("summary", {}, `To mind (${found.warnings.length})`), bench.lines(found.warnings)));
    parts.push(bench.again(found.command));
    at("card").replaceChildren(...parts);
  };
  at("asked").addEventListener("input", (event) => {
    if (event.target.name === "history") return;
    clearTimeout(waiting);
    waiting = setTimeout(ask, 120);
  });
  at("asked").addEventListener("submit", (event) => event.preventDefault());
  at("asked").elements.history.addEventListener("change", async (event) => {
    const file = event.target.files[0];
    if (!file || !(await bench.ask(`/api/history?name=${encodeURIComponent(file.name)}`, "PUT", file))) return;
    history = true;
    at("no-history").hidden = false;
    bench.say(`${file.name} is the history that the card is for: slip, or with storey height and lever arm drift of the storey.`);
    ask();
  });
  at("no-history").addEventListener("click", () => {
    history = false;
    at("no-history").hidden = true;
    at("asked").elements.history.value = "";
    ask();
  });

  at("pool").addEventListener("click", async () => {
    const job = await bench.ask("/api/pool", "POST");
    if (job) { bench.jobs.set(job.id, job); bars(); }
  });
  at("margins").addEventListener("click", async () => {
    const job = await bench.ask("/api/margins", "POST", wanted());
    if (job) { bench.jobs.set(job.id, job); bars(); }
  });
  at("compared").addEventListener("submit", async (event) => {
    event.preventDefault();
    const { a, b } = Object.fromEntries(new FormData(at("compared")));
    const found = await bench.ask("/api/compare", "POST", { a, b });
    if (!found) return;
    const number = (value) => (value === null || value === undefined ? "-" : Number(value).toPrecision(3));
    at("comparison").replaceChildren(bench.lines(found.first), bench.table(`${found.set_a} over ${found.set_b}, or their difference`, ["Quantity", "Middle", "90 % interval", "P(first above)", "P(alike)"], found.contrasts.map((one) => [bench.term(one.quantity), number(one.q50), `${number(one.q05)} to ${number(one.q95)}`, number(one.probability_level), number(one.probability_rope)])), el("details", {}, el("summary", {}, "Every quantity in a sentence, and what many comparisons mean"), bench.lines([...found.contrasts.map((one) => one.sentence), ...found.curves.map((one) => one.sentence)]), el("p", {}, found.multiplicity)), bench.again(found.command));
  });
  at("planned").addEventListener("submit", async (event) => {
    event.preventDefault();
    const { device, ...limits } = Object.fromEntries(new FormData(at("planned")));
    const job = await bench.ask(`/api/devices/${device}/plan`, "POST", limits);
    if (job) { bench.jobs.set(job.id, job); bars(); }
  });
  bench.onLongJob = (job) => {
    bars();
    if (job.state !== "done") return;
    if (job.kind === "pool") {
      at("card").replaceChildren();
      at("report").replaceChildren();
      bench.say("The devices are pooled: margins, comparison and report are here.");
    }
    if (job.kind === "margins") bench.say("The sheet of margins was written: see the pages below.");
    if (job.kind === "plan") at("report").replaceChildren(el("h2", {}, "Next test"), ...bench.page(job.target, "plan", "plan of the next test"), el("p", {}, el("button", { type: "button", onclick: pages }, "Other pages")));
  };
})();
