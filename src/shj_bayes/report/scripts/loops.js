/* The loops of a device to look into: zoom, read off, pick cycles, play. Draws on a canvas from the numbers of the page. */
(() => {
  const DASH = [7, 4];
  const SPEEDS = [1, 5, 20, 60, 200];

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const short = (value) => (Math.abs(value) >= 100 ? value.toFixed(0) : Math.abs(value) >= 10 ? value.toFixed(1) : value.toFixed(2));
  const signed = (value) => (value >= 0 ? "+" : "−") + short(Math.abs(value));

  const decode = (run, scale) => {
    const channel = (name, factor) => run[name] && Float64Array.from(run[name], (whole) => whole * factor);
    const out = { name: run.name, every: run.every, cycles: run.cycles, t: channel("t", scale.t), x: channel("x", scale.x) };
    for (const name of ["measured", "before", "after", "low", "high"]) out[name] = channel(name, scale.force);
    return out;
  };

  const extent = (...lists) => {
    let low = Infinity;
    let high = -Infinity;
    for (const list of lists) {
      if (!list) continue;
      for (const value of list) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    const margin = 0.05 * (high - low || 1);
    return [low - margin, high + margin];
  };

  const view = (box, data) => {
    const runs = data.runs.map((run) => decode(run, data.scale));
    const unit = data.unit || "kN";
    const state = { run: 0, cycle: -1, at: null, zoom: null, playing: 0, speed: 20, drag: null };
    const show = { measured: true, before: true, after: Boolean(runs[0].after), band: Boolean(runs[0].low) && !runs[0].after };
    let split = null;
    /* A law has one colour on all pictures of a page: the base law of a diagnosis, the model of a device. */
    const base = Boolean(runs[0].after) || data.ink === "base";
    const inks = { before: base ? "--v-before" : "--v-after", after: "--v-after" };

    const canvas = el("canvas", { class: "plot", tabindex: "0", role: "img", "aria-label": "Force over displacement. Keys: arrows left and right step through time, up and down choose the cycle, plus and minus zoom, 0 shows all, space plays." });
    const strip = el("canvas", { class: "strip", "aria-hidden": "true" });
    const moved = runs[0].before ? null : el("canvas", { class: "strip", "aria-hidden": "true" });
    const said = el("output", { class: "read" });
    const choice = el("select", { onchange: () => pickRun(Number(choice.value)) }, ...runs.map((run, i) => el("option", { value: i }, run.name)));
    const cycle = el("select", { onchange: () => pickCycle(Number(cycle.value)) });
    const time = el("input", { type: "range", step: "1", oninput: () => goTo(Number(time.value)) });
    const speed = el("select", { onchange: () => { state.speed = Number(speed.value); } }, ...SPEEDS.map((s) => el("option", { value: s, selected: s === state.speed }, s === 1 ? "real time" : `${s} times faster`)));
    const play = el("button", { type: "button", onclick: () => setPlaying(!state.playing) }, "Play");
    const wipe = el("input", { type: "range", min: "0", max: "100", value: "50", "aria-label": "Place of the line between before and after", oninput: () => { split = Number(wipe.value) / 100; draw(); } });
    const button = (words, name, act) => el("button", { type: "button", "aria-label": name, title: name, onclick: act }, words);
    const tick = (name, words) => {
      const input = el("input", { type: "checkbox", onchange: () => { show[name] = input.checked; draw(); } });
      input.checked = show[name];
      return el("label", { class: `key ${name === "before" && !base ? "after" : name}` }, input, " ", words);
    };
    const wiper = el("input", { type: "checkbox", onchange: () => { split = wiper.checked ? Number(wipe.value) / 100 : null; wipe.disabled = !wiper.checked; draw(); } });
    wipe.disabled = true;

    const labelled = (words, ...nodes) => el("label", {}, words, " ", ...nodes);
    box.append(
      el("div", { class: "bar" }, labelled("Run", choice), labelled("Cycles", cycle), button("+", "Zoom in", () => zoomBy(0.6)), button("−", "Zoom out", () => zoomBy(1 / 0.6)), button("Whole loop", "Show the whole loop", () => { state.zoom = null; draw(); })),
      el("div", { class: "bar" }, tick("measured", "measured"), ...(runs[0].before ? [tick("before", data.names.before)] : []), ...(runs[0].after ? [tick("after", data.names.after)] : []), ...(runs[0].low ? [tick("band", data.names.band)] : [])),
      ...(runs[0].after ? [el("div", { class: "bar" }, el("label", {}, wiper, " Before | after: wipe across"), wipe)] : []),
      canvas, said,
      el("div", { class: "bar" }, play, labelled("Time", time), labelled("Speed", speed), button("CSV", "Download the points of this run as CSV", save)),
      strip,
      ...(moved ? [moved] : []),
    );
    const loops = new Sheet(canvas, "displacement (mm)", `force (${unit})`);
    const left = new Sheet(strip, "time (s)", runs[0].before ? `residual (${unit})` : `force (${unit})`);

    const motion = moved && new Sheet(moved, "time (s)", "displacement (mm)");

    const run = () => runs[state.run];
    const span = () => {
      const { cycles, t } = run();
      return state.cycle < 0 ? [0, t.length] : [cycles[state.cycle], Math.min(cycles[state.cycle + 1] + 1, t.length)];
    };
    const cycleOf = (i) => {
      const { cycles } = run();
      let k = 0;
      while (k < cycles.length - 2 && cycles[k + 1] <= i) k += 1;
      return k;
    };

    function pickRun(number) {
      state.run = number;
      state.zoom = null;
      const { cycles, x } = run();
      const size = (k) => {
        let reach = 0;
        for (let i = cycles[k]; i < cycles[k + 1]; i += 1) reach = Math.max(reach, Math.abs(x[i]));
        return reach;
      };
      cycle.replaceChildren(el("option", { value: -1 }, "all"), ...cycles.slice(0, -1).map((_, k) => el("option", { value: k }, `${k + 1} (± ${size(k).toFixed(0)} mm)`)));
      pickCycle(-1);
    }

    function pickCycle(number) {
      state.cycle = clamp(number, -1, run().cycles.length - 2);
      cycle.value = state.cycle;
      const [a, b] = span();
      Object.assign(time, { min: a, max: b - 1, value: a });
      state.at = null;
      said.textContent = "Point at the loop to read it off; drag to zoom in.";
      draw();
    }

    function goTo(i, loud = true) {
      const [a, b] = span();
      state.at = clamp(i, a, b - 1);
      time.value = state.at;
      if (loud) tell(state.at);
      draw();
    }

    function tell(i) {
      const r = run();
      const parts = [`${r.name}, cycle ${cycleOf(i) + 1}, ${r.t[i].toFixed(1)} s: ${signed(r.x[i])} mm, measured ${signed(r.measured[i])} ${unit}`];
      for (const name of ["before", "after"]) {
        if (r[name]) parts.push(`${data.names[name]} ${signed(r[name][i])} ${unit} (residual ${signed(r.measured[i] - r[name][i])} ${unit})`);
      }
      said.textContent = parts.join("; ");
    }

    function setPlaying(on) {
      state.playing = on ? performance.now() : 0;
      play.textContent = on ? "Pause" : "Play";
      if (!on) return;
      const [a, b] = span();
      if (state.at === null || state.at >= b - 1) goTo(a);
      let clock = run().t[state.at];
      const step = (now) => {
        if (!state.playing || !box.isConnected) return;
        clock += ((now - state.playing) / 1000) * state.speed;
        state.playing = now;
        const [, end] = span();
        let i = state.at;
        while (i < end - 1 && run().t[i + 1] <= clock) i += 1;
        goTo(i);
        if (i >= end - 1) setPlaying(false);
        else requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    }

    function zoomBy(factor) {
      const { x0, x1, y0, y1 } = loops;
      const x = (x0 + x1) / 2;
      const y = (y0 + y1) / 2;
      state.zoom = { x: [x - ((x1 - x0) / 2) * factor, x + ((x1 - x0) / 2) * factor], y: [y - ((y1 - y0) / 2) * factor, y + ((y1 - y0) / 2) * factor] };
      draw();
    }

    let waiting = false;
    function draw() {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; paint(); });
    }

    function paint() {
      const r = run();
      const [a, b] = span();
      const few = b - a < 2500;
      loops.begin(state.zoom ? state.zoom.x : extent(r.x), state.zoom ? state.zoom.y : extent(r.measured, r.before));
      const law = (name, style, dash) => (pen) => {
        if (show.band && name === "before" && r.low) loops.ribbon(r.x, r.low, r.high, a, b, colour("--v-band"));
        if (show[name] && r[name]) {
          pen.globalAlpha = state.at === null ? 1 : 0.35;
          loops.line(r.x, r[name], a, b, style, 1.8, few || split !== null ? dash : []);
          if (state.at !== null) {
            pen.globalAlpha = 1;
            loops.line(r.x, r[name], trail(a), state.at + 1, style, 2.4, dash);
          }
        }
      };
      loops.inside((pen) => {
        pen.globalAlpha = state.at === null ? 1 : 0.3;
        if (show.measured && few) loops.dots(r.x, r.measured, a, b, colour("--ink"));
        else if (show.measured) loops.line(r.x, r.measured, a, b, colour("--soft"), 0.8);
        if (show.measured && state.at !== null) {
          pen.globalAlpha = 1;
          loops.dots(r.x, r.measured, trail(a), state.at + 1, colour("--ink"));
        }
      });
      loops.inside(law("before", colour(inks.before), r.after ? DASH : []), 0, split ?? 1);
      if (r.after) loops.inside(law("after", colour(inks.after), []), split ?? 0, 1);
      loops.inside((pen) => {
        pen.strokeStyle = colour("--ink");
        pen.lineWidth = 1.5;
        if (split !== null) {
          const place = EDGE.left + split * loops.wide;
          loops.rule(place, EDGE.top, place, EDGE.top + loops.high);
          pen.fillStyle = colour("--ink");
          pen.textAlign = "right";
          pen.fillText("before", place - 8, EDGE.top + 16);
          pen.textAlign = "left";
          pen.fillText("after", place + 8, EDGE.top + 16);
        }
        if (state.at !== null) {
          pen.beginPath();
          pen.arc(loops.px(r.x[state.at]), loops.py(r.measured[state.at]), 6, 0, 7);
          pen.stroke();
        }
        if (state.drag) {
          const { x, y, toX, toY } = state.drag;
          pen.setLineDash([4, 3]);
          pen.strokeRect(x, y, toX - x, toY - y);
          pen.setLineDash([]);
        }
      });
      paintStrip(r, a, b);
    }

    function trail(a) {
      return Math.max(a, run().cycles[cycleOf(state.at)]);
    }

    function paintStrip(r, a, b) {
      const minus = (name) => r[name] && r.measured.map((force, i) => force - r[name][i]);
      const before = minus("before");
      const after = minus("after");
      left.begin([r.t[0], r.t[r.t.length - 1]], before ? extent(before, after) : extent(r.measured));
      if (motion) {
        motion.begin([r.t[0], r.t[r.t.length - 1]], extent(r.x));
        motion.inside(() => motion.line(r.t, r.x, 0, r.t.length, colour("--soft"), 0.8));
      }
      left.inside((pen) => {
        if (state.cycle >= 0) {
          pen.fillStyle = colour("--card");
          pen.fillRect(left.px(r.t[a]), EDGE.top, left.px(r.t[b - 1]) - left.px(r.t[a]), left.high);
        }
        if (!before) left.line(r.t, r.measured, 0, r.t.length, colour("--soft"), 0.8);
        else if (show.before) left.line(r.t, before, 0, r.t.length, colour(inks.before), 0.8);
        if (show.after && after) left.line(r.t, after, 0, r.t.length, colour(inks.after), 0.8);
        if (state.at !== null) {
          pen.strokeStyle = colour("--ink");
          left.rule(left.px(r.t[state.at]), EDGE.top, left.px(r.t[state.at]), EDGE.top + left.high);
        }
      });
    }

    function nearest(px, py) {
      const r = run();
      const [a, b] = span();
      let best = -1;
      let least = 30 ** 2;
      for (let i = a; i < b; i += 1) {
        const far = (loops.px(r.x[i]) - px) ** 2 + (loops.py(r.measured[i]) - py) ** 2;
        if (far < least) [best, least] = [i, far];
      }
      return best;
    }

    function save() {
      const r = run();
      const columns = ["t", "x", "measured", "before", "after", "low", "high"].filter((name) => r[name]);
      const heads = { t: "time_s", x: "displacement_mm", measured: `measured_${unit}`, before: `model_${unit}`, after: `model_after_${unit}`, low: `band_low_${unit}`, high: `band_high_${unit}` };
      const rows = Array.from(r.t, (_, i) => columns.map((name) => +r[name][i].toFixed(4)).join(","));
      saveAs(`${r.name.replace(/\W+/g, "-")}-points`, [columns.map((name) => heads[name]).join(","), ...rows, ""].join("\r\n"));
    }

    const place = (event) => {
      const { left: x, top: y } = canvas.getBoundingClientRect();
      return [event.clientX - x, event.clientY - y];
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") return;
      const [x, y] = place(event);
      state.drag = { x, y, toX: x, toY: y };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = place(event);
      if (state.drag) {
        Object.assign(state.drag, { toX: x, toY: y });
        draw();
      } else if (!state.playing) {
        const i = nearest(x, y);
        if (i >= 0) goTo(i);
      }
    });
    canvas.addEventListener("pointerup", () => {
      const drag = state.drag;
      state.drag = null;
      if (drag && Math.abs(drag.toX - drag.x) > 12 && Math.abs(drag.toY - drag.y) > 12) {
        const order = (p, q) => [Math.min(p, q), Math.max(p, q)];
        state.zoom = { x: order(loops.x(drag.x), loops.x(drag.toX)), y: order(loops.y(drag.y), loops.y(drag.toY)) };
      }
      draw();
    });
    canvas.addEventListener("pointerleave", () => {
      if (!state.playing && document.activeElement !== canvas) { state.at = null; draw(); }
    });
    canvas.addEventListener("dblclick", () => { state.zoom = null; draw(); });
    canvas.addEventListener("keydown", (event) => {
      const far = event.shiftKey ? 10 : 1;
      const at = state.at ?? span()[0];
      const act = {
        ArrowRight: () => goTo(at + far), ArrowLeft: () => goTo(at - far),
        ArrowUp: () => pickCycle(state.cycle + 1), ArrowDown: () => pickCycle(state.cycle - 1),
        "+": () => zoomBy(0.6), "-": () => zoomBy(1 / 0.6), 0: () => { state.zoom = null; draw(); }, " ": () => setPlaying(!state.playing),
      }[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    });
    strip.addEventListener("click", (event) => {
      const t = left.x(event.clientX - strip.getBoundingClientRect().left);
      const i = run().t.findIndex((value) => value >= t);
      pickCycle(cycleOf(i < 0 ? run().t.length - 1 : i));
    });
    new ResizeObserver(draw).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    box.hidden = false;
    pickRun(0);
    if (data.cycle !== undefined) pickCycle(data.cycle);
  };

  window.showLoops = view;
  document.documentElement.classList.add("js");
  for (const box of document.querySelectorAll("[data-loops]")) view(box, JSON.parse(document.getElementById(box.dataset.loops).textContent));
})();
