"use strict";
(function () {
  const NS = "http://www.w3.org/2000/svg", ACROSS = 20000, UP = 5000;
  const all = (root, selector) => [...root.querySelectorAll(selector)];
  let printed = false;
  addEventListener("beforeprint", () => { printed = true; for (const d of all(document, "details")) d.open = true; });
  addEventListener("afterprint", () => { printed = false; });
  function put(parent, name, attributes, words) {
    const element = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (words !== undefined) element.textContent = words;
    parent.append(element);
    return element;
  }
  function make(name, properties, ...children) {
    const element = Object.assign(document.createElement(name), properties);
    element.append(...children);
    return element;
  }
  function select(name, options, chosen, act) {
    const element = make("select", {}, ...options.map((o, k) => make("option", { value: k }, o)));
    element.selectedIndex = chosen;
    element.addEventListener("change", act);
    return [make("label", {}, `${name} `, element), element];
  }
  const say = (value, digits) => value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "\u2212");
  const three = (value) => String(Number(value.toPrecision(3))).replace("-", "\u2212");
  function ticks(low, high, most) {
    const unit = 10 ** Math.floor(Math.log10((high - low) / most)), found = [];
    const range = (step) => [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
    const step = [0.5, 1, 2, 5, 10].map((s) => s * unit).find((s) => range(s)[1] - range(s)[0] <= most);
    for (let k = range(step)[0]; k <= range(step)[1]; k++) found.push(k * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }
  function axisX(g, low, high, from, to, y, most) {
    put(g, "path", { d: `M${from} ${y}H${to}`, class: "axis" });
    const { found, digits } = ticks(low, high, most);
    for (const v of found) {
      const at = from + ((v - low) / (high - low)) * (to - from);
      put(g, "path", { d: `M${at} ${y}v4`, class: "tick" });
      put(g, "text", { x: at, y: y + 15, "text-anchor": "middle" }, say(v, digits));
    }
  }
  function axisY(g, low, high, bottom, top, x, to, most) {
    put(g, "path", { d: `M${x} ${top}V${bottom}`, class: "axis" });
    const { found, digits } = ticks(low, high, most);
    for (const v of found) {
      const at = bottom - ((v - low) / (high - low)) * (bottom - top);
      put(g, "path", { d: `M${x - 4} ${at}H${to}`, class: v === 0 ? "zero" : to > x ? "gridline" : "tick" });
      put(g, "text", { x: x - 6, y: at + 4, "text-anchor": "end" }, say(v, digits));
    }
  }

  function panel(svg, k) {
    const view = svg.querySelector(".view"), gx = svg.querySelector(".ticksx"), gy = svg.querySelector(".ticksy");
    const [left, top, height] = ["x", "y", "height"].map((n) => Number(view.getAttribute(n)));
    const p = { svg, left, top, height, unit: svg.dataset.unit, width: 0 }, full = svg.viewBox.baseVal.height;
    p.name = svg.querySelector(".title").textContent.replace(/^error in | \[.*$/g, "");
    p.load = (run) => {
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
    p.fit = () => {
      const room = printed ? 740 : svg.parentElement.clientWidth || 740, wide = Math.max(300, Math.min(740, room));
      p.width = wide - left - 8;
      svg.setAttribute("viewBox", `0 0 ${wide} ${full}`);
      view.setAttribute("width", p.width);
      for (const t of all(svg, ".middle")) t.setAttribute("x", left + p.width / 2);
    };
    p.show = (a, b) => {
      let low = Infinity, high = -Infinity;
      for (const points of p.lines) for (const [x, y] of points)
        if (x >= a && x <= b) { low = Math.min(low, y); high = Math.max(high, y); }
      if (!(high >= low)) { low = -UP; high = UP; }
      const margin = 0.05 * (high - low) || 0.02 * UP, time = (x) => p.span[0] + (x / ACROSS) * (p.span[1] - p.span[0]);
      if (b - a >= ACROSS) { low = -1.05 * UP; high = 1.05 * UP; } else { low -= margin; high += margin; }
      view.setAttribute("viewBox", `${a} ${low} ${b - a} ${high - low}`);
      gx.replaceChildren();
      gy.replaceChildren();
      axisX(gx, time(a), time(b), left, left + p.width, top + height, p.width > 450 ? 7 : 4);
      axisY(gy, (-high / UP) * p.reach, (-low / UP) * p.reach, top + height, top, left, left + p.width, 6);
    };
    p.read = (at) => p.lines.map((points) => {
      let near = Infinity, x = 0;
      for (const [px] of points) if (Math.abs(px - at) < near) { near = Math.abs(px - at); x = px; }
      const here = points.filter(([px]) => px === x).map(([, y]) => (-y / UP) * p.reach);
      const ends = [...new Set([Math.min(...here), Math.max(...here)].map(three))];
      return here.length ? ends.join(" to ") : "none";
    });
    p.cursor = (part) => {
      const d = part === null ? "" : `M${left + part * p.width} ${top}v${height}`;
      (svg.querySelector(".cursor") || put(svg, "path", { class: "cursor" })).setAttribute("d", d);
    };
    return p;
  }
  function series(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent), panels = all(figure, "svg.panel").map(panel);
    const output = make("output", {}), readout = make("span", { className: "readout" }), bar = make("div", { className: "zoom" });
    let from = 0, to = ACROSS, run = data.runs[0];
    const time = (x) => Number((run.from + (x / ACROSS) * (run.to - run.from)).toPrecision(4));
    function go(a, b) {
      const size = Math.min(ACROSS, Math.max(run.least, b - a));
      from = Math.min(Math.max(0, (a + b - size) / 2), ACROSS - size);
      to = from + size;
      for (const p of panels) p.show(from, to);
      output.textContent = `${time(from)} to ${time(to)} ${data.unit}`;
    }
    function load(next) {
      run = next;
      for (const p of panels) { p.load(run); p.cursor(null); }
      figure.querySelector(".run").textContent = run.title;
      figure.querySelector(".columns").textContent = run.note && `; ${run.note}`;
      readout.textContent = "";
      go(0, ACROSS);
    }
    const by = (factor) => { const m = (from + to) / 2, h = ((to - from) / 2) * factor; go(m - h, m + h); };
    const move = (part) => { const d = (to - from) * part; go(from + d, to + d); };
    const actions = [["+", "zoom in", () => by(0.5)], ["\u2212", "zoom out", () => by(2)],
      ["\u2190", "earlier", () => move(-0.4)], ["\u2192", "later", () => move(0.4)], ["all", "show all", () => go(0, ACROSS)]];
    const titles = data.runs.map((r, k) => r.title + (k ? "" : " (worst)"));
    const [label, pick] = select("run, worst first", titles, 0, () => load(data.runs[pick.selectedIndex]));
    if (data.runs.length > 1) bar.append(label);
    for (const [sign, title, act] of actions) {
      const button = make("button", { type: "button" }, sign);
      button.setAttribute("aria-label", title);
      button.addEventListener("click", act);
      bar.append(button);
    }
    bar.append(output, readout);
    figure.querySelector("figcaption").after(bar);
    const keys = { "+": 0, "=": 0, "-": 1, ArrowLeft: 2, ArrowRight: 3, 0: 4, Escape: 4 };
    figure.addEventListener("keydown", (event) => {
      if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey || event.target === pick) return;
      event.preventDefault();
      actions[keys[event.key]][2]();
    });
    const hover = (part) => {
      for (const p of panels) p.cursor(part);
      if (part === null) return (readout.textContent = "");
      const at = from + part * (to - from);
      const values = panels.map((p) => `${p.name} ${p.read(at).join(" | ")} ${p.unit}`);
      readout.textContent = `at ${time(at)} ${data.unit}: ${values.join("; ")}`;
    };
    for (const p of panels) pointer(p, hover, (a, b) => go(from + a * (to - from), from + b * (to - from)));
    const fit = () => { for (const p of panels) p.fit(); go(from, to); output.textContent = to - from < ACROSS ? output.textContent : ""; };
    load(run);
    fit();
    new ResizeObserver(fit).observe(figure);
    for (const name of ["beforeprint", "afterprint"]) addEventListener(name, () => { hover(null); fit(); });
  }
  function pointer(p, hover, done) {
    let begin = null, mark = null;
    const at = (event) => {
      const box = p.svg.getBoundingClientRect(), x = ((event.clientX - box.left) / box.width) * p.svg.viewBox.baseVal.width;
      return Math.min(1, Math.max(0, (x - p.left) / p.width));
    };
    p.svg.style.touchAction = "pan-x pan-y";
    p.svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "mouse" || event.button !== 0) return hover(at(event));
      begin = at(event);
      p.svg.setPointerCapture(event.pointerId);
      mark = put(p.svg, "rect", { class: "select", y: p.top, height: p.height, x: 0, width: 0 });
      event.preventDefault();
      p.svg.closest("figure").focus({ preventScroll: true });
    });
    p.svg.addEventListener("pointermove", (event) => {
      const now = at(event);
      hover(now);
      if (begin === null) return;
      mark.setAttribute("x", p.left + Math.min(begin, now) * p.width);
      mark.setAttribute("width", Math.abs(now - begin) * p.width);
    });
    p.svg.addEventListener("pointerleave", () => { if (begin === null) hover(null); });
    for (const name of ["pointerup", "pointercancel"]) p.svg.addEventListener(name, (event) => {
      if (begin === null) return;
      const now = at(event), [a, b] = [Math.min(begin, now), Math.max(begin, now)];
      mark.remove();
      begin = null;
      if (name === "pointerup" && b - a > 0.01) done(a, b);
    });
  }

  function planes(box) {
    const { titles, planes } = JSON.parse(box.querySelector("script").textContent);
    const names = [...new Set(planes.flatMap((p) => [p.by, p.up]))];
    function show(svg, x, y) {
      const plane = planes.find((p) => (p.by === x && p.up === y) || (p.by === y && p.up === x)), turned = plane.by !== x;
      const { version, what, output } = svg.dataset, values = plane.values[version][what][output];
      const full = plane.full[what][output], [quantity, unit] = titles[output];
      const [ex, ey] = turned ? [plane.across, plane.edges] : [plane.edges, plane.across], n = plane.edges.length - 1;
      const [left, right, top, bottom] = [44, 226, 22, 204], last = (e) => e[e.length - 1];
      const px = (v) => left + ((v - ex[0]) / (last(ex) - ex[0])) * (right - left);
      const py = (v) => bottom - ((v - ey[0]) / (last(ey) - ey[0])) * (bottom - top);
      svg.replaceChildren();
      put(svg, "text", { x: 0, y: 12, class: "title" }, `${what} ${quantity}, full: ${three(full)} ${unit}`);
      axisY(svg, ey[0], last(ey), bottom, top, left, left, 4);
      axisX(svg, ex[0], last(ex), left, right, bottom, 4);
      put(svg, "text", { x: (left + right) / 2, y: bottom + 29, "text-anchor": "middle", class: "soft" }, `${x}, upwards ${y}`);
      values.forEach((value, k) => {
        if (value === null) return;
        const [i, j] = turned ? [Math.floor(k / n), k % n] : [k % n, Math.floor(k / n)];
        const [x0, x1, y0, y1] = [px(ex[i]), px(ex[i + 1]), py(ey[j + 1]), py(ey[j])];
        const cell = put(svg, "rect", { x: x0, y: y0, width: x1 - x0, height: y1 - y0, class: value < 0 ? "neg" : "pos",
          "fill-opacity": Math.min(1, Math.abs(value) / full) });
        put(cell, "title", {}, `${three(ex[i])} to ${three(ex[i + 1])}, ${three(ey[j])} to ${three(ey[j + 1])}: ${three(value)} ${unit}, ${plane.count[k]} samples`);
        if (value < -0.1 * full) put(svg, "path", { class: "dash", d: `M${x0 + 0.3 * (x1 - x0)} ${(y0 + y1) / 2}H${x0 + 0.7 * (x1 - x0)}` });
      });
      const most = Math.max(...values.map((v) => Math.abs(v)));
      svg.setAttribute("aria-label", `${what} error of ${quantity} over ${x} and ${y}: ${three(most)} ${unit} at most`);
    }
    function change(event) {
      if (across.value === up.value) {
        const other = event.target === across ? up : across;
        other.selectedIndex = (across.selectedIndex + 1) % names.length;
      }
      for (const svg of all(box, "svg.plane")) show(svg, names[across.selectedIndex], names[up.selectedIndex]);
    }
    const [first, across] = select("across", names, names.indexOf(planes[0].by), change);
    const [second, up] = select("upwards", names, names.indexOf(planes[0].up), change);
    if (names.length > 2) box.prepend(make("div", { className: "zoom" }, first, second));
  }

  function sortable(table) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
    const key = (row, k) => row.cells[k].textContent.replace(/\u2212/g, "-").replace(/^[(<\s]+/, "");
    heads.forEach((head, k) => {
      const button = make("button", { type: "button" }, head.textContent);
      head.replaceChildren(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
        for (const h of heads) h.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down > 0 ? "ascending" : "descending");
        const order = (a, b) => {
          const [p, q] = [key(a, k), key(b, k)], [m, n] = [parseFloat(p), parseFloat(q)];
          return down * (Number.isNaN(m) || Number.isNaN(n) ? p.localeCompare(q, "en", { numeric: true }) : m - n);
        };
        body.append(...[...body.rows].sort(order));
      });
    });
  }
  function copy(pre) {
    const words = pre.textContent, button = make("button", { type: "button" }, "copy");
    button.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(words);
      } catch {
        getSelection().selectAllChildren(pre);
        if (!document.execCommand("copy")) return (button.textContent = "selected: press Ctrl+C");
      }
      button.textContent = "copied";
    });
    button.setAttribute("aria-live", "polite");
    pre.after(button);
  }
  all(document, ".next pre").forEach(copy);
  all(document, "figure.series").forEach(series);
  all(document, ".planes").forEach(planes);
  all(document, "table.sortable").forEach(sortable);
})();
