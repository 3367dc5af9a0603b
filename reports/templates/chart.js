// Score against training time: one plot at a time, time on a log axis, values on hover or by the arrow keys.
(() => {
  const plots = page.data.plots;
  if (!plots.length) return;
  const [boardSelect, scoreSelect, logBox] = ["plot-board", "plot-score", "plot-log"].map((id) => document.getElementById(id));
  const box = document.getElementById("chart"), legend = document.getElementById("plot-legend");
  const tables = [...document.querySelectorAll(".plot-tables")];   // in the order of the plots
  const boards = [...new Set(plots.map((plot) => plot.board))];
  const hidden = new Set();   // names of series that are switched off
  let plot, marks = [], place, at = -1;

  const colour = (look) => `var(--s${look % 7})`;
  const dash = (look) => ["", "7 4", "2 4", "9 3 2 3"][Math.floor(look / 7) % 4];
  const seconds = (t) => t >= 100 ? t.toFixed(0) : t >= 1 ? t.toFixed(1) : t.toPrecision(2);
  const value = (score) => score.toFixed(plot.digits) + (plot.unit ? ` ${plot.unit}` : "");

  /** The path of a marker of radius r; its shape tells series apart without colour. */
  function shape(look, x, y, r) {
    const s = r * 0.9, t = r * 1.25;
    return [
      `M${x - r},${y}a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0`,
      `M${x - s},${y - s}h${2 * s}v${2 * s}h${-2 * s}z`,
      `M${x},${y - t}l${t},${2 * t * 0.87}h${-2 * t}z`,
      `M${x},${y - t}l${t},${t}l${-t},${t}l${-t},${-t}z`,
      `M${x},${y + t}l${t},${-2 * t * 0.87}h${-2 * t}z`,
      `M${x - s},${y - r * 0.35}h${2 * s}v${r * 0.7}h${-2 * s}z`,
    ][look % 6];
  }

  function logTicks(low, high, most) {
    for (const factors of [[1, 2, 5], [1, 3], [1]]) {
      const found = [];
      for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
        for (const factor of factors) found.push(factor * 10 ** power);
      const inside = found.filter((tick) => tick >= low * 0.999 && tick <= high * 1.001);
      if (inside.length <= most || factors.length === 1) return inside;
    }
    return [];
  }

  function evenTicks(low, high, most) {
    const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k++) found.push(k * step);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return found.map((tick) => [tick, tick.toFixed(digits)]);
  }

  function draw() {
    const shown = plot.series.map((series, index) => ({ ...series, index })).filter((series) => !hidden.has(series.name));
    const points = shown.flatMap((series) => series.runs.flatMap((run) => run.points));
    const width = Math.max(280, box.clientWidth), height = Math.round(Math.min(460, Math.max(270, width * 0.52)));
    const edge = { left: 58, right: 14, top: 26, bottom: 46 };
    const svg = page.make("svg", {
      viewBox: `0 0 ${width} ${height}`, height, tabindex: 0, role: "application", "aria-roledescription": "chart",
      "aria-label": `${plot.label} against ${plot.clock} on ${plot.board}. Arrow keys: left and right along a curve, up and down `
        + "between curves. The tables below hold the same in words.",
    });
    marks = [];
    if (!points.length) {
      svg.append(page.make("text", { x: width / 2, y: height / 2, "text-anchor": "middle" }, "Every curve is switched off."));
      box.replaceChildren(svg);
      return;
    }
    const times = points.map((point) => point[0]);
    let [t0, t1] = [Math.min(...times), Math.max(...times)];
    [t0, t1] = t0 === t1 ? [t0 / 2, t1 * 2] : [t0 * (t0 / t1) ** 0.03, t1 * (t1 / t0) ** 0.03];
    const scores = points.map((point) => point[1]);
    if (plot.nothing !== null) scores.push(plot.nothing);
    const positive = Math.min(...scores) > 0;
    logBox.disabled = !positive;
    const log = logBox.checked && positive;
    let [v0, v1] = [Math.min(...scores), Math.max(...scores)];
    if (v0 === v1) [v0, v1] = log ? [v0 / 2, v1 * 2] : [v0 - 1, v1 + 1];
    else if (log) [v0, v1] = [v0 * (v0 / v1) ** 0.05, v1 * (v1 / v0) ** 0.05];
    else [v0, v1] = [v0 - 0.05 * (v1 - v0), v1 + 0.05 * (v1 - v0)];
    const wide = width - edge.left - edge.right, high = height - edge.top - edge.bottom;
    const x = (t) => edge.left + wide * Math.log(t / t0) / Math.log(t1 / t0);
    const part = (v) => log ? Math.log(v / v0) / Math.log(v1 / v0) : (v - v0) / (v1 - v0);
    const y = (v) => edge.top + high * (1 - part(v));
    place = { x, y, svg, width, height };

    const bottom = height - edge.bottom, right = width - edge.right;
    for (const tick of logTicks(t0, t1, wide / 56)) {
      svg.append(page.make("line", { class: "grid", x1: x(tick), x2: x(tick), y1: edge.top, y2: bottom }));
      svg.append(page.make("text", { x: x(tick), y: bottom + 17, "text-anchor": "middle" }, String(+tick.toPrecision(3))));
    }
    const ticks = log ? logTicks(v0, v1, high / 36).map((tick) => [tick, String(+tick.toPrecision(3))]) : evenTicks(v0, v1, high / 44);
    for (const [tick, text] of ticks) {
      svg.append(page.make("line", { class: "grid", x1: edge.left, x2: right, y1: y(tick), y2: y(tick) }));
      svg.append(page.make("text", { x: edge.left - 8, y: y(tick) + 4, "text-anchor": "end" }, text));
    }
    svg.append(page.make("line", { class: "axis", x1: edge.left, x2: right, y1: bottom, y2: bottom }));
    svg.append(page.make("text", { class: "title", x: 2, y: 13 }, plot.heading + (log ? ", log axis" : "")));
    svg.append(page.make("text", { class: "title", x: right, y: height - 6, "text-anchor": "end" }, `${plot.clock} [s], log axis`));
    for (const level of plot.levels) {
      if (level <= v0 || level >= v1) continue;
      svg.append(page.make("line", { class: "level", x1: edge.left, x2: right, y1: y(level), y2: y(level) }));
    }
    if (plot.nothing !== null) {
      svg.append(page.make("line", { class: "nothing", x1: edge.left, x2: right, y1: y(plot.nothing), y2: y(plot.nothing) }));
      svg.append(page.make("text", { x: right - 4, y: y(plot.nothing) - 5, "text-anchor": "end" }, "do nothing"));
    }
    drawFront(svg, x, y);
    for (const series of shown) drawSeries(svg, series, x, y);
    svg.append(page.make("g", { class: "focus" }));
    svg.addEventListener("pointermove", (event) => hover(event));
    svg.addEventListener("pointerdown", (event) => hover(event));
    svg.addEventListener("pointerleave", unfocus);
    svg.addEventListener("blur", unfocus);
    svg.addEventListener("keydown", keys);
    box.replaceChildren(svg);
  }

  const steps = (points, x, y) =>
    points.map(([t, v], k) => k ? `H${x(t)}V${y(v)}` : `M${x(t)},${y(v)}`).join("");

  function drawFront(svg, x, y) {
    const front = plot.front.filter(([, , index]) => !hidden.has(plot.series[index].name));
    if (front.length > 1) svg.append(page.make("path", { class: "front", d: steps(front, x, y) }));
  }

  function drawSeries(svg, series, x, y) {
    const several = series.median.length > 0, look = series.place;
    for (const run of series.runs) {
      if (!run.points.length) continue;
      svg.append(page.make("path", {
        d: run.points.map(([t, v], k) => `${k ? "L" : "M"}${x(t)},${y(v)}`).join(""), fill: "none", stroke: colour(look),
        "stroke-width": several ? 1 : 2, "stroke-opacity": several ? 0.55 : 1, "stroke-dasharray": dash(look), "stroke-linejoin": "round",
      }));
      for (const [t, v] of run.points) {
        svg.append(page.make("path", { d: shape(look, x(t), y(v), several ? 2.2 : 3.4), fill: colour(look),
          "fill-opacity": several ? 0.6 : 1 }));
        const who = run.seed === null ? series.name : `${series.name}, seed ${run.seed}`; // null: a mean over scenes
        marks.push({ t, v, series, who, line: `${series.index}/${run.seed}` });
      }
    }
    if (several) {
      svg.append(page.make("path", { d: steps(series.median, x, y), fill: "none", stroke: colour(look), "stroke-width": 2.6,
        "stroke-dasharray": dash(look) }));
      for (const [t, v] of series.median)
        marks.push({ t, v, series, who: `${series.name}, median of ${series.runs.length} seeds`, line: `${series.index}/median` });
    }
  }

  function hover(event) {
    const frame = place.svg.getBoundingClientRect(), scale = place.width / frame.width;
    const px = (event.clientX - frame.left) * scale, py = (event.clientY - frame.top) * scale;
    let best = -1, least = 48;
    marks.forEach((mark, k) => {
      const far = Math.hypot(place.x(mark.t) - px, place.y(mark.v) - py);
      if (far < least) [best, least] = [k, far];
    });
    if (best < 0) unfocus(); else focus(best);
  }

  function focus(k) {
    at = k;
    const mark = marks[k], layer = place.svg.querySelector(".focus");
    const cx = place.x(mark.t), cy = place.y(mark.v);
    layer.replaceChildren(
      page.make("line", { class: "cross", x1: cx, x2: cx, y1: 26, y2: place.height - 46 }),
      page.make("path", { d: shape(mark.series.place, cx, cy, 6), fill: colour(mark.series.place), stroke: "var(--card)", "stroke-width": 2 }),
    );
    const first = plot.front.some(([t, v, index]) => t === mark.t && v === mark.v && index === mark.series.index);
    const text = `${plot.label} ${value(mark.v)} after ${seconds(mark.t)} s` + (first ? ", on the Pareto front" : "");
    const frame = place.svg.getBoundingClientRect(), scale = frame.width / place.width;
    page.tip(frame.left + cx * scale, frame.top + cy * scale, page.make("b", {}, mark.who), page.make("br"), text);
    return `${mark.who}: ${text}`;
  }

  function unfocus() {
    at = -1;
    page.untip();
    place?.svg.querySelector(".focus")?.replaceChildren();
  }

  function keys(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!way || !marks.length) return;
    event.preventDefault();
    const lines = [...new Set(marks.map((mark) => mark.line))];
    let next = 0;
    if (at >= 0) {
      const mark = marks[at];
      const line = lines[(lines.indexOf(mark.line) + way[1] + lines.length) % lines.length];
      const own = marks.map((_, k) => k).filter((k) => marks[k].line === line).sort((a, b) => marks[a].t - marks[b].t);
      const here = way[1]
        ? own.reduce((a, b) => Math.abs(Math.log(marks[b].t / mark.t)) < Math.abs(Math.log(marks[a].t / mark.t)) ? b : a)
        : own[Math.max(0, Math.min(own.length - 1, own.indexOf(at) + way[0]))];
      next = here;
    }
    page.say(focus(next));
  }

  function drawLegend() {
    legend.replaceChildren(...plot.series.map((series) => {
      const swatch = page.make("svg", { viewBox: "0 0 34 14", "aria-hidden": "true" },
        page.make("path", { d: "M1,7H33", stroke: colour(series.place), "stroke-width": 2, "stroke-dasharray": dash(series.place), fill: "none" }),
        page.make("path", { d: shape(series.place, 17, 7, 4), fill: colour(series.place) }));
      const lost = series.runs.reduce((sum, run) => sum + run.dropped, 0);
      const more = [series.runs.length > 1 ? `${series.runs.length} seeds` : "", series.failures,
        lost ? `${lost} scores not finite, not drawn` : ""].filter(Boolean).join("; ");
      const button = page.make("button", { type: "button", "aria-pressed": !hidden.has(series.name) }, swatch, series.name,
        ...(more ? [page.make("span", {}, `(${more})`)] : []));
      button.addEventListener("click", () => {
        if (!hidden.delete(series.name)) hidden.add(series.name);
        button.setAttribute("aria-pressed", !hidden.has(series.name));
        draw();
      });
      return page.make("li", {}, button);
    }));
  }

  function choose() {
    const own = plots.filter((one) => one.board === boards[boardSelect.selectedIndex]);
    page.choices(scoreSelect, own.map((one) => one.label));
    show();
  }

  function show() {
    const own = plots.filter((one) => one.board === boards[boardSelect.selectedIndex]);
    plot = own[scoreSelect.selectedIndex];
    const index = plots.indexOf(plot);
    tables.forEach((one, place) => one.classList.toggle("shown", place === index));
    document.getElementById("plot-note").textContent = `${plot.label}: ${plot.note}.`;
    logBox.checked = !plot.higher;
    unfocus();
    drawLegend();
    draw();
  }

  page.choices(boardSelect, boards);
  // The one with most to compare comes first.
  const count = (board) => Math.max(...plots.filter((one) => one.board === board).map((one) => one.series.length));
  boardSelect.selectedIndex = boards.map(count).indexOf(Math.max(...boards.map(count)));
  boardSelect.addEventListener("change", choose);
  scoreSelect.addEventListener("change", show);
  logBox.addEventListener("change", draw);
  let seen = 0;
  new ResizeObserver(() => { if (box.clientWidth !== seen) { seen = box.clientWidth; draw(); } }).observe(box);
  addEventListener("scroll", unfocus, { passive: true });
  choose();
})();
