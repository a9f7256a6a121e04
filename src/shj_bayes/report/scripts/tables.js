/* Tables that sort, filter and go into a spreadsheet. Without scripts they are plain tables. */
(() => {
  const words = (node) => node.textContent.replace(/\s+/g, " ").trim();

  /* Parts of a cell: its value (exact where the page has it), then each small line below it. */
  const parts = (cell) => {
    const copy = cell.cloneNode(true);
    const small = [...copy.querySelectorAll(".more")].map((node) => { node.remove(); return words(node); });
    const exact = copy.querySelector("data");
    return [exact ? exact.value : words(copy), ...small];
  };
  /* A spreadsheet must not read a name as a formula. */
  const quoted = (text) => `"${(/^[=+\-@\t]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text).replaceAll('"', '""')}"`;

  const save = (table, name) => {
    const rows = [...table.rows].filter((row) => !row.hidden).map((row) => [...row.cells].map(parts));
    const wide = rows[0].map((_, column) => Math.max(...rows.map((row) => row[column]?.length ?? 0)));
    const lines = rows.map((row, line) => wide.flatMap((n, column) => Array.from({ length: n }, (_, i) => {
      const cell = row[column] ?? [];
      return quoted(cell[i] ?? (line === 0 ? `${cell[0]}: more` : ""));
    })).join(","));
    saveAs(name, `${lines.join("\r\n")}\r\n`);
  };

  const sortable = (table) => {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = el("button", { type: "button", class: "sort", onclick: () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const key = (row) => (row.cells[column] ? parts(row.cells[column])[0] : "");
        const order = (p, q) => (p !== "" && q !== "" && !Number.isNaN(Number(p)) && !Number.isNaN(Number(q)) ? Number(p) - Number(q) : p.localeCompare(q, "en", { numeric: true }));
        const body = table.tBodies[0];
        body.append(...[...body.rows].sort((p, q) => (down ? -1 : 1) * order(key(p), key(q))));
      } });
      button.append(...head.childNodes);
      head.append(button);
    });
  };

  const filterable = (table, bar) => {
    const rows = [...table.tBodies[0].rows];
    const count = el("span", { role: "status" });
    const input = el("input", { type: "search", oninput: () => {
      const wanted = input.value.toLowerCase().split(/\s+/);
      rows.forEach((row) => { row.hidden = !wanted.every((word) => words(row).toLowerCase().includes(word)); });
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} shown`;
    } });
    bar.append(el("label", {}, "Filter ", input), count);
  };

  document.querySelectorAll(".scroll > table").forEach((table, number) => {
    const bar = el("div", { class: "bar tools" });
    if (table.classList.contains("filterable")) filterable(table, bar);
    if (table.tHead && table.classList.contains("sortable")) sortable(table);
    const near = table.closest("section, details, main")?.querySelector("h2[id]");
    const name = `${document.title} table ${number + 1}`.replace(/[^\p{L}\p{N}]+/gu, "-").toLowerCase();
    const what = table.caption ? words(table.caption).slice(0, 60) : near ? words(near) : `table ${number + 1}`;
    bar.append(el("button", { type: "button", "aria-label": `Download as CSV: ${what}`, onclick: () => save(table, name) }, "CSV"));
    table.parentElement.before(bar);
  });

  /* What scrolls sideways must be reachable from the keyboard. */
  const reach = () => document.querySelectorAll(".scroll, .pan").forEach((box) => {
    if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
    else box.removeAttribute("tabindex");
  });
  addEventListener("resize", reach);
  addEventListener("load", reach);
})();
