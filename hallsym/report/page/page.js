"use strict";
(function () {
  const NS = "http://www.w3.org/2000/svg", ACROSS = 20000, UP = 10000;
  function ticks(low, high, most) {
    const unit = 10 ** Math.floor(Math.log10((high - low) / most)), found = [];
    const range = (step) => [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
    const fits = (step) => range(step)[1] - range(step)[0] <= most;
    const step = [0.5, 1, 2, 5, 10].map((s) => s * unit).find(fits), [first, last] = range(step);
    for (let k = first; k <= last; k++) found.push(k * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }
  function put(parent, name, attributes, words) {
    const element = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (words !== undefined) element.textContent = words;
    parent.append(element);
    return element;
  }
  const say = (value, digits) => value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "\u2212");
  function panel(svg) {
    const view = svg.querySelector(".view"), data = svg.dataset;
    const [left, top, width, height] = ["x", "y", "width", "height"].map((n) => Number(view.getAttribute(n)));
    const start = Number(data.from), span = Number(data.to) - start, reach = Number(data.reach);
    const lines = [...view.querySelectorAll("path")].map((path) => {
      let x = 0, y = 0;
      const steps = (path.getAttribute("d").match(/-?\d+/g) || []).map(Number), points = [];
      for (let k = 0; k < steps.length; k += 2) points.push([(x += steps[k]), (y += steps[k + 1])]);
      return points;
    });
    function show(a, b) {
      let low = Infinity, high = -Infinity;
      for (const points of lines) for (const [x, y] of points)
        if (x >= a && x <= b) { low = Math.min(low, y); high = Math.max(high, y); }
      if (!(high >= low)) { low = -UP; high = UP; }
      const margin = 0.05 * (high - low) || 0.02 * UP;
      if (b - a >= ACROSS) { low = -1.05 * UP; high = 1.05 * UP; } else { low -= margin; high += margin; }
      view.setAttribute("viewBox", `${a} ${low} ${b - a} ${high - low}`);
      const gx = svg.querySelector(".ticksx"), gy = svg.querySelector(".ticksy"), bottom = top + height;
      gx.replaceChildren();
      gy.replaceChildren();
      put(gx, "path", { d: `M${left} ${bottom}H${left + width}`, class: "axis" });
      put(gy, "path", { d: `M${left} ${top}V${bottom}`, class: "axis" });
      const xs = ticks(start + (a / ACROSS) * span, start + (b / ACROSS) * span, 7);
      for (const v of xs.found) {
        const at = left + (((v - start) / span) * ACROSS - a) / (b - a) * width;
        put(gx, "path", { d: `M${at} ${bottom}v4`, class: "tick" });
        put(gx, "text", { x: at, y: bottom + 15, "text-anchor": "middle" }, say(v, xs.digits));
      }
      const ys = ticks((-high / UP) * reach, (-low / UP) * reach, 6);
      for (const v of ys.found) {
        const at = top + ((-v / reach) * UP - low) / (high - low) * height;
        put(gy, "path", { d: `M${left - 4} ${at}H${left + width}`, class: v === 0 ? "zero" : "gridline" });
        put(gy, "text", { x: left - 6, y: at + 4, "text-anchor": "end" }, say(v, ys.digits));
      }
    }
    return { svg, show, left, top, width, height, start, span };
  }
  function setup(figure) {
    const panels = [...figure.querySelectorAll("svg.panel")].map(panel);
    const bar = document.createElement("div"), output = document.createElement("output");
    let from = 0, to = ACROSS;
    bar.className = "zoom";
    output.setAttribute("aria-live", "polite");
    function go(a, b) {
      const size = Math.min(ACROSS, Math.max(Number(figure.dataset.least), b - a));
      from = Math.min(Math.max(0, (a + b - size) / 2), ACROSS - size);
      to = from + size;
      for (const p of panels) p.show(from, to);
      const { start, span } = panels[0], time = (x) => Number((start + (x / ACROSS) * span).toPrecision(4));
      output.textContent = `${time(from)} to ${time(to)} ${figure.dataset.unit}`;
    }
    const by = (factor) => { const m = (from + to) / 2, h = ((to - from) / 2) * factor; go(m - h, m + h); };
    const move = (part) => { const d = (to - from) * part; go(from + d, to + d); };
    const actions = [["+", "zoom in", () => by(0.5)], ["\u2212", "zoom out", () => by(2)],
      ["\u2190", "earlier", () => move(-0.4)], ["\u2192", "later", () => move(0.4)], ["all", "show all", () => go(0, ACROSS)]];
    for (const [sign, title, act] of actions) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = sign;
      button.setAttribute("aria-label", `${title}, ${figure.getAttribute("aria-label")}`);
      button.addEventListener("click", act);
      bar.append(button);
    }
    bar.append(output);
    figure.querySelector("figcaption").after(bar);
    const keys = { "+": 0, "=": 0, "-": 1, ArrowLeft: 2, ArrowRight: 3, 0: 4, Escape: 4 };
    figure.addEventListener("keydown", (event) => {
      if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      actions[keys[event.key]][2]();
    });
    for (const p of panels) drag(p, (a, b) => go(from + a * (to - from), from + b * (to - from)));
  }
  function drag(p, done) {
    let begin = null, mark = null;
    const at = (event) => {
      const box = p.svg.getBoundingClientRect(), x = ((event.clientX - box.left) / box.width) * p.svg.viewBox.baseVal.width;
      return Math.min(1, Math.max(0, (x - p.left) / p.width));
    };
    p.svg.style.touchAction = "pan-x pan-y";
    p.svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "mouse" || event.button !== 0) return;
      begin = at(event);
      p.svg.setPointerCapture(event.pointerId);
      mark = put(p.svg, "rect", { class: "select", y: p.top, height: p.height, x: 0, width: 0 });
      event.preventDefault();
      p.svg.closest("figure").focus({ preventScroll: true });
    });
    p.svg.addEventListener("pointermove", (event) => {
      if (begin === null) return;
      const now = at(event);
      mark.setAttribute("x", p.left + Math.min(begin, now) * p.width);
      mark.setAttribute("width", Math.abs(now - begin) * p.width);
    });
    for (const name of ["pointerup", "pointercancel"]) p.svg.addEventListener(name, (event) => {
      if (begin === null) return;
      const now = at(event), [a, b] = [Math.min(begin, now), Math.max(begin, now)];
      mark.remove();
      begin = null;
      if (name === "pointerup" && b - a > 0.01) done(a, b);
    });
  }
  document.querySelectorAll("figure.series").forEach(setup);
})();
