// The last and next hours: supply by tier, stored energy and import, over one time axis.

import { kilo, percent, storedShare } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 68, RIGHT = 22, TOP = 20, TIER = 26, ROW = 96, GAP = 30, AXIS = 22, STRIP = 14;

export function element(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// A level from one share to another, with marks where limits are; the rest may be bad.
export function meter(to, { from = 0, kind = "", rest = "", marks = [], name = "" } = {}) {
  const x = (value) => 100 * Math.min(1, Math.max(0, value));
  return element("svg", { class: "meter", role: "img", "aria-label": name },
    element("rect", { class: `track ${rest}`, width: "100%", height: 14, rx: 2 }),
    element("rect", { class: `level ${kind}`, x: `${x(from)}%`, width: `${Math.max(x(to) - x(from), from ? 1.5 : 0)}%`, height: 14, rx: 2 }),
    ...marks.map((mark) => element("line", { class: "mark", x1: `${x(mark)}%`, x2: `${x(mark)}%`, y1: -3, y2: 17 })));
}

// The steps of the overview, and older ones if they were asked for.
export function pastOf(view) {
  const { past } = view.overview;
  return [...(view.history ?? []).filter((step) => past.length && step.start < past[0].start), ...past];
}

// Past steps, the current one, and planned ones.
export function stepsOf(view) {
  const { plan } = view.overview, past = pastOf(view);
  const length = view.site.step_s * 1000;
  const stored = (soc) => soc && storedShare(view.site, (name) => soc[name]);
  const known = past.map((step) => ({
    begin: new Date(step.start).getTime(), status: step.status, reason: step.reason, served: step.served,
    stored: stored(step.expected?.soc), import: step.expected?.import_kw ?? null, limit: step.expected?.grid_limit_kw ?? null,
    ahead: false, decided: step.expected !== null,
  }));
  const ahead = plan?.ahead;
  const foreseen = (ahead?.times ?? []).map((time, t) => ({
    begin: new Date(time).getTime(), status: "planned",
    served: Object.fromEntries(Object.entries(ahead.served).map(([tier, row]) => [tier, row[t]])),
    stored: stored(Object.fromEntries(Object.entries(ahead.soc).map(([name, row]) => [name, row[t]]))),
    import: ahead.import_kw[t], limit: ahead.grid_limit_kw[t], ahead: true, decided: true,
  }));
  return [...known, ...foreseen].map((step) => ({ ...step, end: step.begin + length }));
}

export function chart(view, width) {
  const steps = stepsOf(view);
  if (!steps.length) return null;
  const first = steps[0].begin, last = steps.at(-1).end;
  const x = (time) => LEFT + ((time - first) / (last - first)) * (width - LEFT - RIGHT);
  const tiers = view.site.tiers;
  const tops = { tiers: TOP, store: TOP + tiers.length * TIER + GAP };
  tops.import = tops.store + ROW + GAP;
  tops.strip = tops.import + ROW + 8;
  const height = tops.strip + STRIP + AXIS;
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": inWords(view, steps) });
  shadeOutages(svg, steps, x, tops);
  tiers.forEach((tier, row) => drawTier(svg, tier, tops.tiers + row * TIER, steps, x));
  drawRow(svg, { name: "stored (%)", top: tops.store, kind: "store", most: 1, least: 0, label: (v) => Math.round(100 * v) },
    steps.map((step) => [[step.end, step.stored]]), steps, x, width);
  drawImport(svg, tops.import, steps, x, width);
  drawStrip(svg, tops.strip, steps, x);
  drawTimes(svg, view, first, last, x, tops.strip + STRIP, width);
  const now = x(Math.min(last, Math.max(first, view.now)));
  svg.append(element("line", { class: "now", x1: now, x2: now, y1: TOP - 4, y2: tops.strip + STRIP }),
    element("text", { class: "now-word", x: now, y: 12, "text-anchor": now > width - 30 ? "end" : "middle" }, "now"));
  return svg;
}

function inWords(view, steps) {
  const on = steps.filter((step) => step.ahead);
  const dark = steps.filter((step) => step.limit === 0).length;
  const low = Math.min(...on.map((step) => step.stored ?? 1));
  return `Customers supplied by tier, stored energy and import over ${steps.length} steps, ${on.length} of them planned; ${dark} without grid.` +
    (on.length ? ` Planned minimum of stored energy: ${percent(low)}.` : "");
}

function shadeOutages(svg, steps, x, tops) {
  for (const step of steps.filter((one) => one.limit === 0)) {
    svg.append(element("rect", { class: "outage", x: x(step.begin), y: TOP - 6, width: x(step.end) - x(step.begin) + .5, height: tops.strip - TOP + 4 }));
  }
}

function drawTier(svg, tier, top, steps, x) {
  const tall = TIER - 6;
  svg.append(element("text", { class: "name", x: LEFT - 8, y: top + 14, "text-anchor": "end" }, shortened(tier)));
  for (const step of steps.filter((one) => one.decided)) {
    const wide = Math.max(1, x(step.end) - x(step.begin) - 1);
    const on = step.served[tier] * tall;
    const ahead = step.ahead ? " ahead" : "";
    if (on < tall) svg.append(element("rect", { class: `off${ahead}`, x: x(step.begin), y: top, width: wide, height: tall - on }));
    if (on > 0) svg.append(element("rect", { class: `on${ahead}`, x: x(step.begin), y: top + tall - on, width: wide, height: on }));
  }
}

const shortened = (name) => (name.length > 10 ? `${name.slice(0, 9)}\u2026` : name);

function drawImport(svg, top, steps, x, width) {
  const drawn = steps.map((step) => step.import ?? 0);
  const most = rounded(Math.max(...drawn, 2)), least = 0 - rounded(Math.max(...drawn.map((value) => -1 - value), 0));
  const row = { name: "import (kW)", top, kind: "import", most, least, label: kilo };
  drawRow(svg, row, steps.map((step) => [[step.begin, step.import], [step.end, step.import]]), steps, x, width);
  const y = (value) => top + ROW * (1 - (value - least) / (most - least));
  for (const step of steps.filter((one) => one.limit > 0 && one.limit <= most)) {
    svg.append(element("line", { class: "limit", x1: x(step.begin), x2: x(step.end), y1: y(step.limit), y2: y(step.limit) }));
  }
}

// The next round number: 1, 2 or 5 times a power of ten.
function rounded(value) {
  if (value <= 0) return 0;
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 1.5, 2, 3, 5, 7.5, 10].find((factor) => factor * power >= value);
}

function drawRow(svg, row, points, steps, x, width) {
  const y = (value) => row.top + ROW * (1 - (value - row.least) / (row.most - row.least));
  svg.append(element("text", { class: "name", x: LEFT, y: row.top - 7 }, row.name));
  for (const value of row.least < 0 ? [row.least, 0, row.most] : [row.least, (row.least + row.most) / 2, row.most]) {
    svg.append(element("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(value), y2: y(value) }),
      element("text", { x: LEFT - 8, y: y(value) + 4, "text-anchor": "end" }, row.label(value)));
  }
  for (const ahead of [false, true]) {
    let path = "", before = null;
    steps.forEach((step, t) => {
      const from = ahead && !step.ahead && steps[t + 1]?.ahead; // the curve ahead begins where the past ends
      if (step.ahead !== ahead && !from) return;
      for (const [time, value] of from ? points[t].slice(-1) : points[t]) {
        if (value === null || value === undefined) { before = null; continue; }
        path += `${before === null ? "M" : "L"}${x(time).toFixed(1)},${y(value).toFixed(1)}`;
        before = value;
      }
    });
    if (path) svg.append(element("path", { class: `curve ${row.kind}${ahead ? " ahead" : ""}`, d: path }));
  }
}

// Below: steps with exceptions.
function drawStrip(svg, top, steps, x) {
  const signs = { fallback: ["odd", "F"], off: ["odd", "0"], hold: ["odd", "H"], manual: ["odd", "M"], failed: ["bad", "!"], missed: ["bad", "\u00d7"] };
  for (const step of steps) {
    const sign = signs[step.status];
    if (!sign) continue;
    const words = element("title", {}, `${step.status}${step.reason ? `: ${step.reason}` : ""}`);
    svg.append(element("text", { class: sign[0], x: (x(step.begin) + x(step.end)) / 2, y: top + 11, "text-anchor": "middle" }, sign[1], words));
  }
}

function drawTimes(svg, view, first, last, x, top, width) {
  const hours = (last - first) / 3.6e6, room = (width - LEFT - RIGHT) / 52;
  const every = [0.25, 0.5, 1, 2, 3, 4, 6, 12, 24].find((step) => hours / step <= room) ?? 24;
  svg.append(element("line", { class: "edge", x1: LEFT, x2: width - RIGHT, y1: top, y2: top }));
  const minutes = (time) => view.clock.hm.format(time).split(":").reduce((h, m) => 60 * Number(h) + Number(m));
  let zone = view.clock.zone(first);
  for (let time = Math.ceil(first / 9e5) * 9e5; time <= last; time += 9e5) {
    if (minutes(time) % (60 * every)) continue;
    const changed = view.clock.zone(time) === zone ? "" : ` ${zone = view.clock.zone(time)}`;
    svg.append(element("line", { class: "edge", x1: x(time), x2: x(time), y1: top, y2: top + 5 }),
      element("text", { x: x(time), y: top + 18, "text-anchor": "middle" }, view.clock.hm.format(time) + changed));
  }
}
