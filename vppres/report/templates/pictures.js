// Charts and the feeder's diagram: values under the pointer, zoom and pan, and pictures that are as
// wide as the window. A page is complete without it.
const Pictures = (function () {
  "use strict";
  const SVG = "http://www.w3.org/2000/svg";
  const PAPER = 860, LEAST_PX = 300, MOST_PX = 1088, TICK_PX = 60, DRAG_PX = 6;
  const EVERY_MIN = [1, 5, 10, 15, 30, 60, 120, 180, 240, 360, 720, 1440];

  function element(name, attributes = {}, ...children) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) { made.setAttribute(key, value); }
    made.append(...children);
    return made;
  }

  function html(name, properties, ...children) {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  }

  const parsed = (text) => text.match(/^(.*?) ?(\d\d):(\d\d)(.*)$/);

  // Steps of round times in a part of the axis, each with its date and time of day, and with the zone
  // where clocks have been changed since the tick before.
  function ticksOf(times, from, to, room) {
    const clock = times.map(parsed), minutes = clock.map((found) => 60 * found[2] + Number(found[3]));
    const step = times.length > 1 ? (minutes[1] - minutes[0] + 1440) % 1440 || 1440 : 60;
    const span = (to - from) * times.length * step, most = Math.max(2, Math.floor(room / TICK_PX));
    const every = EVERY_MIN.find((m) => span / m <= most) || 1440 * Math.ceil(span / 1440 / most);
    const day = (t) => Math.floor((minutes[0] + t * step) / 1440) * 1440;
    return [...times.keys()].filter((t) =>
      t >= from * times.length && t <= to * times.length && (day(t) + minutes[t]) % every === 0)
      .map((t, i, ticks) => {
        const zone = i && clock[t][4] !== clock[ticks[i - 1]][4] ? clock[t][4] : "";
        return { t, words: [clock[t][1], `${clock[t][2]}:${clock[t][3]}${zone}`] };
      });
  }

  // A drawing whose axis is stretched over a width, and shows a part of what it holds.
  class Axis {
    constructor(svg, times) {
      this.svg = svg;
      this.times = times;
      this.all = (selector) => [...svg.querySelectorAll(selector)];
      this.frames = this.all("svg.time");
      const { x, width } = this.frames[0].viewBox.baseVal, whole = svg.viewBox.baseVal;
      Object.assign(this, { left: x, across: width, wide: whole.width, height: whole.height, from: 0, to: 1 });
      this.right = this.wide - x - width;
      const share = (text) => (Number(text.getAttribute("x")) - x) / width;
      this.moved = this.all("text.at").map((text) => ({ text, share: share(text) }));
      this.entries = this.all("g.entry").map((group) => {
        const line = group.querySelector("text");
        return { group, px: Number(group.dataset.px), x: Number(line.getAttribute("x")) - 36, y: Number(line.getAttribute("y")) };
      });
      this.named = this.all("text.tick");
      this.lines = new Set(this.named.map((text) => text.getAttribute("y"))).size;
      this.drawn = svg.appendChild(element("g"));
    }

    place(share) {
      return this.left + (share - this.from) / (this.to - this.from) * this.room;
    }

    shareAt(event) {
      const { left, width } = this.svg.getBoundingClientRect();
      const x = (event.clientX - left) * this.width / width;
      return this.from + (x - this.left) / this.room * (this.to - this.from);
    }

    layout(width, from = this.from, to = this.to) {
      const room = Math.max(60, width - this.left - this.right);
      Object.assign(this, { from, to, width: width, room });
      const seen = (to - from) * this.across, dx = room - this.across;
      for (const frame of this.frames) {
        const { y, height } = frame.viewBox.baseVal;
        frame.setAttribute("width", room);
        frame.setAttribute("viewBox", `${this.left + from * this.across} ${y} ${seen} ${height}`);
      }
      this.all("pattern").forEach((one) => one.setAttribute("patternTransform", `scale(${seen / room} 1)`));
      this.all("g.right").forEach((one) => one.setAttribute("transform", `translate(${dx} 0)`));
      this.all("text.title").forEach((one) => this.centre(one, width / 2));
      this.all("text.middle").forEach((one) => this.centre(one, this.left + room / 2));
      if (this.times) { this.tick(); }
      this.moveTexts();
      const height = this.height + this.reflow();
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svg.setAttribute("width", width);
      this.svg.setAttribute("height", height);
    }

    // A text in the middle of what it is about, within the drawing.
    centre(text, x) {
      text.style.fontSize = "";
      const long = text.getComputedTextLength(), most = this.width - 4;
      if (long > most) { text.style.fontSize = `${parseFloat(getComputedStyle(text).fontSize) * most / long}px`; }
      const half = Math.min(long, most) / 2;
      text.setAttribute("x", Math.min(Math.max(x, half + 2), this.width - half - 2));
    }

    tick() {
      this.named.forEach((text) => { text.style.display = "none"; });
      const found = ticksOf(this.times, this.from, this.to, this.room), share = (one) => one.t / this.times.length;
      const rules = found.map((one) => this.left + share(one) * this.across);
      this.frames.forEach((frame) => frame.querySelectorAll("g.ticks").forEach((group) => {
        const { y, height } = frame.viewBox.baseVal;
        const d = rules.map((x) => `M${x} ${y + 2}v${height - 6}`).join("");
        group.replaceChildren(element("path", { d, stroke: "#D0D0D0", "stroke-width": 0.6, fill: "none" }));
      }));
      const top = Math.min(...this.named.map((text) => Number(text.getAttribute("y"))));
      this.drawn.replaceChildren(...found.flatMap((one) => one.words.slice(-this.lines).map((words, line) =>
        element("text", { x: this.place(share(one)), y: top + 13.2 * line, "text-anchor": "middle" }, words))));
    }

    // Texts at their times; those that are out of sight or would lie on the one before are hidden.
    moveTexts() {
      const ends = {};
      for (const { text, share } of this.moved) {
        if (this.times && text.classList.contains("tick")) { continue; }
        const x = this.place(share), y = text.getAttribute("y");
        text.setAttribute("x", x);
        text.style.display = "";
        const half = text.getComputedTextLength() / 2, [least, most] = text.classList.contains("tick")
          ? [0, this.width] : [this.left, this.left + this.room];
        const fits = x - half > (ends[y] ?? least) - 1 && x + half <= most + 1;
        if (fits) { ends[y] = x + half + 3; } else { text.style.display = "none"; }
      }
    }

    // Entries of the legend in rows that fit; by how much they became higher.
    reflow() {
      if (!this.entries.length) { return 0; }
      const rows = [[]];
      let used = 0;
      for (const entry of this.entries) {
        if (used && used + entry.px - 22 > this.width - 8) { rows.push([]); used = 0; }
        rows.at(-1).push(entry);
        used += entry.px;
      }
      const first = this.entries[0].y, before = new Set(this.entries.map((entry) => entry.y)).size;
      rows.forEach((row, line) => {
        let x = Math.max(2, (this.width + 22 - row.reduce((sum, entry) => sum + entry.px, 0)) / 2);
        for (const entry of row) {
          entry.group.setAttribute("transform", `translate(${x - entry.x} ${first + 17.2 * line - entry.y})`);
          x += entry.px;
        }
      });
      return 17.2 * (rows.length - before);
    }
  }

  // Charts over the same steps: they are read, zoomed and marked together.
  class Charts {
    constructor(times, outages, rowWords = () => []) {
      Object.assign(this, { times, rowWords, charts: [], chosen: 0, next: 0, onChoose: () => {}, onZoom: () => {} });
      this.spans = outages;
    }

    add(figure, data) {
      const svg = figure.querySelector("svg"), axis = new Axis(svg, this.times);
      const cursor = element("line", { class: "cursor", y1: data.top, y2: data.bottom });
      const marked = element("rect", { class: "marked", y: data.top, height: data.bottom - data.top, width: 0 });
      svg.append(marked, cursor);
      const words = figure.querySelector(".readings") ?? figure.appendChild(html("p", { className: "readings" }));
      const buttons = html("p", { className: "zoom screen-only" },
        ...(this.spans.length ? [html("button", { type: "button", textContent: "Outage", onclick: () => this.toOutage() })] : []),
        html("button", { type: "button", textContent: "Whole", onclick: () => this.zoom(0, 1) }));
      figure.prepend(buttons);
      const chart = { figure, data, axis, cursor, marked, words };
      this.charts.push(chart);
      this.listen(chart);
    }

    listen(chart) {
      const { axis, marked } = chart, { svg } = axis, steps = this.times.length;
      const within = (share) => Math.min(axis.to, Math.max(axis.from, share));
      let start = null;
      svg.addEventListener("pointermove", (event) => {
        const share = axis.shareAt(event);
        if (start !== null) {
          const [a, b] = [start.share, within(share)].map((one) => axis.place(one)).sort((p, q) => p - q);
          marked.setAttribute("x", a);
          marked.setAttribute("width", Math.abs(event.clientX - start.x) > DRAG_PX ? b - a : 0);
        }
        if (share >= axis.from && share < axis.to) { this.show(Math.floor(share * steps), chart, event); }
      });
      svg.addEventListener("pointerdown", (event) => {
        const share = axis.shareAt(event);
        if (event.button || share < axis.from || share > axis.to) { return; }
        start = { share, x: event.clientX };
        svg.setPointerCapture(event.pointerId);
      });
      svg.addEventListener("pointerup", (event) => {
        if (start === null) { return; }
        const [a, b] = [start.share, within(axis.shareAt(event))].sort((p, q) => p - q);
        const far = Math.abs(event.clientX - start.x) > DRAG_PX;
        start = null;
        marked.setAttribute("width", 0);
        if (far) {
          this.zoom(Math.floor(a * steps) / steps, Math.ceil(b * steps) / steps);
        } else if (a < axis.to) { this.choose(Math.min(steps - 1, Math.floor(a * steps))); }
      });
      svg.addEventListener("pointercancel", () => { start = null; marked.setAttribute("width", 0); });
      svg.addEventListener("pointerleave", () => this.show(this.chosen));
      svg.addEventListener("dblclick", () => this.zoom(0, 1));
    }

    zoom(from, to) {
      [this.from, this.to] = [from, to];
      this.onZoom(from, to);
      this.charts.forEach(({ axis }) => axis.layout(axis.width, from, to));
      this.show(this.chosen);
    }

    // The next outage, with a quarter of its length before and after it.
    toOutage() {
      const [first, last] = this.spans[this.next % this.spans.length], steps = this.times.length;
      const room = Math.max(1, Math.round((last - first) / 4));
      this.next += 1;
      this.zoom(Math.max(0, first - room) / steps, Math.min(steps, last + room) / steps);
    }

    choose(step) {
      this.chosen = step;
      this.show(step);
      this.onChoose(step);
    }

    show(step, pointed = null, event = null) {
      for (const chart of this.charts) {
        const { axis, cursor, data, words } = chart, x = axis.place(step / this.times.length);
        const seen = x >= axis.left - 1 && x <= axis.left + axis.room;
        for (const [name, value] of [["x1", x], ["x2", x], ["visibility", seen ? "visible" : "hidden"]]) { cursor.setAttribute(name, value); }
        const known = data.curves.filter((curve) => (curve.values[step] ?? "") !== "").map((curve) => {
          const color = html("i", {});
          color.style.background = curve.color;
          return html("span", {}, color, `${curve.name} `, html("b", { textContent: curve.values[step] }));
        });
        const box = chart === pointed && axis.svg.getBoundingClientRect();
        const y = box ? (event.clientY - box.top) * axis.svg.viewBox.baseVal.height / box.height : NaN;
        const rows = (data.rows ?? []).flatMap((one) => {
          const row = Math.floor((y - one.top) / (one.bottom - one.top) * one.each.length);
          return this.rowWords(one.of, one.each[row] ?? null, step);
        });
        words.replaceChildren(html("strong", { textContent: this.times[step] }), ...rows.map((text) => html("span", { textContent: text })), ...known);
      }
    }

    fit() {
      for (const { figure, axis } of this.charts) { axis.layout(widthOf(figure), this.from, this.to); }
      this.show(this.chosen);
    }
  }

  const widthOf = (figure) => Math.min(MOST_PX, Math.max(LEAST_PX, Math.floor(figure.clientWidth)));

  // The feeder's drawing under a window that can be moved and zoomed. Symbols keep their size, and
  // become smaller only where the whole drawing does.
  class Feeder {
    constructor(svg) {
      this.svg = svg;
      this.scene = svg.querySelector(".scene");
      this.buses = [...svg.querySelectorAll(".bus")];
      const { width, height } = svg.viewBox.baseVal;
      Object.assign(this, { whole: { width, height }, x: 0, y: 0, z: 1 });
      let held = null;
      svg.addEventListener("pointerdown", (event) => { held = [event.clientX - this.x, event.clientY - this.y]; });
      svg.addEventListener("pointermove", (event) => {
        if (held && event.buttons) { this.look(this.z, event.clientX - held[0], event.clientY - held[1]); }
      });
      window.addEventListener("pointerup", () => { held = null; });
      svg.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) { return; }
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY / 300), event);
      }, { passive: false });
      svg.addEventListener("dblclick", (event) => this.zoom(2, event));
    }

    // Everything, no larger than it was drawn.
    fit() {
      this.wide = this.svg.parentElement.clientWidth;
      const z = Math.min(1, this.wide / this.whole.width, 900 / this.whole.height);
      this.high = Math.max(160, this.whole.height * z);
      this.svg.setAttribute("viewBox", `0 0 ${this.wide} ${this.high}`);
      this.svg.setAttribute("width", this.wide);
      this.svg.setAttribute("height", this.high);
      this.look(z, (this.wide - this.whole.width * z) / 2, 0);
    }

    zoom(factor, event = null) {
      const box = this.svg.getBoundingClientRect();
      const [x, y] = event ? [event.clientX - box.left, event.clientY - box.top] : [box.width / 2, box.height / 2];
      const z = Math.min(8, Math.max(0.1, this.z * factor)), k = z / this.z;
      this.look(z, x - (x - this.x) * k, y - (y - this.y) * k);
    }

    look(z, x, y) {
      Object.assign(this, { x, y, z });
      this.scene.setAttribute("transform", `translate(${x} ${y}) scale(${z})`);
      this.svg.classList.toggle("nameless", z < 0.7);
      this.svg.classList.toggle("near", z > 1);
      for (const bus of this.buses) {
        bus.setAttribute("transform", `translate(${bus.dataset.x} ${bus.dataset.y}) scale(${Math.min(1, 1 / z)})`);
      }
    }

    asDrawn() {
      const { width, height } = this.whole;
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.look(1, 0, 0);
      this.svg.classList.remove("nameless");
    }
  }

  // The charts of a page without another script.
  function fitAll() {
    const axes = [...document.querySelectorAll("figure.plot svg:has(svg.time)")].map((svg) => [svg.closest("figure"), new Axis(svg)]);
    const fit = () => axes.forEach(([figure, axis]) => axis.layout(widthOf(figure)));
    window.addEventListener("resize", fit);
    window.addEventListener("beforeprint", () => axes.forEach(([, axis]) => axis.layout(PAPER)));
    window.addEventListener("afterprint", fit);
    fit();
  }

  // Ranges of steps that have a mark.
  function spansOf(marks) {
    const spans = [];
    marks.forEach((mark, t) => {
      if (mark && !marks[t - 1]) { spans.push([t, t]); }
      if (mark) { spans.at(-1)[1] = t + 1; }
    });
    return spans;
  }

  return { Charts, Feeder, element, fitAll, spansOf, PAPER };
})();
