"use strict";
(function () {
  const NS = "http://www.w3.org/2000/svg", ACROSS = 20000, UP = 5000, LEFT = 54, TOP = 22, RIM = 14;
  const all = (root, selector) => [...root.querySelectorAll(selector)];
  let printed = false;
  addEventListener("beforeprint", () => {
    printed = true;
    for (const folded of all(document, "details")) folded.open = true;
  });
  addEventListener("afterprint", () => { printed = false; });
  function put(parent, name, attributes, words = "") {
    const element = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = words;
    return parent.appendChild(element);
  }
  function make(name, properties, ...children) {
    const element = Object.assign(document.createElement(name), properties);
    element.append(...children);
    return element;
  }
  const button = (words, act) => make("button", { type: "button", onclick: act }, words);
  function choice(name, options, act) {
    const select = make("select", {}, ...options.map((o) => make("option", {}, o)));
    select.onchange = () => act(select.selectedIndex);
    return make("label", {}, `${name} `, select);
  }
  const minus = (words) => words.replace("-", "\u2212");
  const three = (value) => minus(String(Number(value.toPrecision(3))));
  function axis(g, [low, high], [from, to], at, grid, most, title) {
    const up = g.classList.contains("up"), unit = 10 ** Math.floor(Math.log10((high - low) / most));
    const first = (step) => Math.ceil(low / step - 1e-9), last = (step) => Math.floor(high / step + 1e-9);
    const step = [0.5, 1, 2, 5, 10].map((s) => s * unit).find((s) => last(s) - first(s) <= most);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const stroke = (a, b, c, d, look = "axis") =>
      put(g, "path", { class: look, d: up ? `M${b} ${a}L${d} ${c}` : `M${a} ${b}L${c} ${d}` });
    g.replaceChildren();
    stroke(from, at, to, at);
    for (let k = first(step); k <= last(step); k++) {
      const p = from + ((k * step - low) / (high - low)) * (to - from);
      if (grid !== null) stroke(p, at, p, grid, k ? "gridline" : "axis");
      stroke(p, at + (up ? -4 : 4), p, at);
      const place = up ? { x: at - 6, y: p + 4, "text-anchor": "end" } : { x: p, y: at + 15, "text-anchor": "middle" };
      put(g, "text", place, minus((k * step).toFixed(k ? digits : 0)));
    }
    if (title) put(g, "text", { x: (from + to) / 2, y: at + 29, "text-anchor": "middle", class: "soft" }, title);
  }

  function panel(drawn, output, lines, title) {  // in the place of a drawing that does not move
    const svg = document.createElementNS(NS, "svg"), height = 90, tall = TOP + height + (title ? 34 : 20);
    for (const name of ["role", "aria-label"]) svg.setAttribute(name, drawn.getAttribute(name));
    svg.setAttribute("class", "panel");
    put(svg, "text", { x: LEFT, y: 12, "font-weight": 600 }, `error in ${output.name} [${output.unit}]`);
    const [up, across] = ["up", "across"].map((name) => put(svg, "g", { class: name }));
    const view = put(svg, "svg", { class: "view", x: LEFT, y: TOP, height, preserveAspectRatio: "none" });
    for (let j = 0; j < lines; j++) put(view, "path", { class: `line ${j === lines - 1 ? "last" : "first"}` });
    drawn.replaceWith(svg);
    const p = { svg, width: 0, name: output.name, unit: output.unit };
    p.load = (run, k) => {
      p.reach = run.reach[k];
      p.span = [run.from, run.to];
      p.lines = all(view, "path").map((path, j) => {
        let x = 0, y = 0;
        path.setAttribute("d", run.lines[j][k]);
        const steps = (run.lines[j][k].match(/-?\d+/g) || []).map(Number), points = [];
        for (let i = 0; i < steps.length; i += 2) points.push([(x += steps[i]), (y += steps[i + 1])]);
        return points;
      });
    };
    p.show = (a, b) => {
      const room = printed ? 740 : svg.parentElement.clientWidth || 740, wide = Math.max(300, Math.min(740, room));
      p.width = wide - LEFT - RIM;
      svg.setAttribute("viewBox", `0 0 ${wide} ${tall}`);
      view.setAttribute("width", p.width);
      const seen = p.lines.flat().filter(([x]) => x >= a && x <= b).map(([, y]) => y);
      const whole = b - a >= ACROSS || !seen.length;
      let [low, high] = whole ? [-UP, UP] : seen.reduce(([l, h], y) => [Math.min(l, y), Math.max(h, y)], [UP, -UP]);
      const margin = 0.05 * (whole ? UP : high - low) || 0.02 * UP;
      [low, high] = [low - margin, high + margin];
      view.setAttribute("viewBox", `${a} ${low} ${b - a} ${high - low}`);
      const times = [a, b].map((x) => p.span[0] + (x / ACROSS) * (p.span[1] - p.span[0]));
      const sizes = [high, low].map((y) => (-y / UP) * p.reach), bottom = TOP + height;
      axis(across, times, [LEFT, LEFT + p.width], bottom, null, p.width > 450 ? 7 : 4, title);
      axis(up, sizes, [bottom, TOP], LEFT, LEFT + p.width, 4);
    };
    p.read = (at) => p.lines.map((points) => {
      const near = points.reduce((best, [x]) => (Math.abs(x - at) < Math.abs(best - at) ? x : best), Infinity);
      const here = points.filter(([x]) => x === near).map(([, y]) => (-y / UP) * p.reach);
      return here.length ? [...new Set([Math.min(...here), Math.max(...here)].map(three))].join(" to ") : "none";
    }).join(" | ");
    p.cursor = (part) => {
      const d = part === null ? "" : `M${LEFT + part * p.width} ${TOP}v${height}`;
      (svg.querySelector(".cursor") || put(svg, "path", { class: "cursor" })).setAttribute("d", d);
    };
    p.mark = (a, b) => {
      all(svg, ".select").forEach((mark) => mark.remove());
      if (b > a) put(svg, "rect", { class: "select", y: TOP, height, x: LEFT + a * p.width, width: (b - a) * p.width });
    };
    return p;
  }
  function series(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent), drawn = all(figure, ".scroll svg");
    const name = (k) => (k === drawn.length - 1 ? data.what : "");
    const panels = drawn.map((svg, k) => panel(svg, data.outputs[k], data.runs[0].lines.length, name(k)));
    const output = make("output", {}), readout = make("span", { className: "readout" });
    let from = 0, to = ACROSS, run = data.runs[0];
    const time = (x) => Number((run.from + (x / ACROSS) * (run.to - run.from)).toPrecision(4));
    function go(a, b) {
      const size = Math.min(ACROSS, Math.max(run.least, b - a));
      from = Math.min(Math.max(0, (a + b - size) / 2), ACROSS - size);
      to = from + size;
      for (const p of panels) p.show(from, to);
      output.textContent = size < ACROSS ? `${time(from)} to ${time(to)} ${data.unit}` : "";
    }
    function hover(part) {
      for (const p of panels) p.cursor(part);
      const at = from + part * (to - from);
      const values = () => panels.map((p) => `${p.name} ${p.read(at)} ${p.unit}`).join("; ");
      readout.textContent = part === null ? "" : `at ${time(at)} ${data.unit}: ${values()}`;
    }
    function load(next) {
      run = next;
      panels.forEach((p, k) => p.load(run, k));
      figure.querySelector(".run").textContent = run.title;
      figure.querySelector(".columns").textContent = run.note && `; ${run.note}`;
      hover(null);
      go(0, ACROSS);
    }
    const by = (factor) => { const m = (from + to) / 2, h = ((to - from) / 2) * factor; go(m - h, m + h); };
    const move = (part) => { const d = (to - from) * part; go(from + d, to + d); };
    const actions = [["+", "zoom in", () => by(0.5)], ["\u2212", "zoom out", () => by(2)],
      ["\u2190", "earlier", () => move(-0.4)], ["\u2192", "later", () => move(0.4)], ["all", "show all", () => go(0, ACROSS)]];
    const buttons = actions.map(([sign, ariaLabel, act]) => Object.assign(button(sign, act), { ariaLabel }));
    const titles = data.runs.map((r, k) => r.title + (k ? "" : " (worst)"));
    const pick = titles.length > 1 ? [choice("run, worst first", titles, (k) => load(data.runs[k]))] : [];
    figure.querySelector("figcaption").after(make("div", { className: "zoom" }, ...pick, ...buttons, output, readout));
    const keys = { "+": 0, "=": 0, "-": 1, ArrowLeft: 2, ArrowRight: 3, 0: 4, Escape: 4 };
    figure.addEventListener("keydown", (event) => {
      if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
      event.preventDefault();
      actions[keys[event.key]][2]();
    });
    for (const p of panels) pointer(p, hover, (a, b) => go(from + a * (to - from), from + b * (to - from)));
    load(run);
    const fit = () => { hover(null); go(from, to); };
    new ResizeObserver(fit).observe(figure);
    for (const name of ["beforeprint", "afterprint"]) addEventListener(name, fit);
  }
  function pointer(p, hover, zoom) {
    let begin = null;
    const on = (name, act) => p.svg.addEventListener(name, (event) => {
      const box = p.svg.getBoundingClientRect(), x = ((event.clientX - box.left) / box.width) * p.svg.viewBox.baseVal.width;
      act(Math.min(1, Math.max(0, (x - LEFT) / p.width)), event);
    });
    const sorted = (at) => [Math.min(begin, at), Math.max(begin, at)];
    p.svg.style.touchAction = "pan-x pan-y";
    on("pointerdown", (at, event) => {
      hover(at);
      if (event.pointerType !== "mouse" || event.button !== 0) return;
      begin = at;
      p.svg.setPointerCapture(event.pointerId);
      event.preventDefault();
      p.svg.closest("figure").focus({ preventScroll: true });
    });
    on("pointermove", (at) => { hover(at); if (begin !== null) p.mark(...sorted(at)); });
    on("pointerleave", () => { if (begin === null) hover(null); });
    for (const name of ["pointerup", "pointercancel"]) on(name, (at) => {
      if (begin === null) return;
      const [a, b] = sorted(at);
      begin = null;
      p.mark(0, 0);
      if (name === "pointerup" && b - a > 0.01) zoom(a, b);
    });
  }

  function sortable(table) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
    const key = (row, k) => row.cells[k].textContent.replace(/\u2212/g, "-").replace(/^[(<\s]+/, "");
    heads.forEach((head, k) => head.replaceChildren(button(head.textContent, () => {
      const down = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const h of heads) h.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down > 0 ? "ascending" : "descending");
      const order = (a, b) => {
        const [p, q] = [key(a, k), key(b, k)], [m, n] = [parseFloat(p), parseFloat(q)];
        return down * (Number.isNaN(m) || Number.isNaN(n) ? p.localeCompare(q, "en", { numeric: true }) : m - n);
      };
      body.append(...[...body.rows].sort(order));
    })));
  }
  function csv(table) {
    const cell = (c) => `"${c.textContent.replace(/\u2212/g, "-").replace(/\u00a0/g, " ").replace(/"/g, '""')}"`;
    const text = [...table.rows].map((row) => [...row.cells].map(cell).join(",")).join("\n");
    const href = `data:text/csv;charset=utf-8,${encodeURIComponent(`${text}\n`)}`, caption = table.caption;
    if (!caption) return;
    const link = make("a", { className: "tool", download: "table.csv", href, ariaLabel: `CSV: ${caption.textContent}` }, "CSV");
    caption.append(" ", link);
  }
  function copy(pre) {
    const done = button("copy", async () => {
      getSelection().selectAllChildren(pre);
      try { await navigator.clipboard.writeText(pre.textContent); } catch { return (done.textContent = "press Ctrl+C"); }
      done.textContent = "copied";
    });
    done.ariaLive = "polite";
    pre.after(done);
  }
  all(document, ".next pre").forEach(copy);
  all(document, "figure.series").forEach(series);
  all(document, "table.sortable").forEach(sortable);
  all(document, "table").forEach(csv);
})();
