// The last and next hours: supply by tier, stored energy and import, over one time axis.

import { kilo, percent, storedShare } from "./words.js";

const { element, PAPER, spansOf } = Pictures; // the report's script, which the page loads before
const LEFT = 74, RIGHT = 22, TOP = 20, TIER = 26, ROW = 96, GAP = 30, AXIS = 22, STRIP = 14, LEAST = 5;
const DAYS_FROM = 48 * 3.6e6; // from this length on, ticks have dates

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

// The drawing, and what its readings and its zoom need: times, outages, and values by step.
export function chart(view) {
  const steps = stepsOf(view);
  if (!steps.length) return null;
  const length = view.site.step_s * 1000, first = steps[0].begin, last = steps.at(-1).end;
  const x = (time) => LEFT + ((time - first) / (last - first)) * (PAPER - LEFT - RIGHT);
  const tiers = view.site.tiers;
  const tops = { tiers: TOP, store: TOP + tiers.length * TIER + GAP };
  tops.import = tops.store + ROW + GAP;
  tops.strip = tops.import + ROW + 8;
  const bottom = tops.strip + STRIP, dated = last - first > DAYS_FROM;
  const height = bottom + AXIS * (dated ? 1.6 : 1), top = TOP - 8, high = bottom - top + 6;
  const svg = element("svg", { viewBox: `0 0 ${PAPER} ${height}`, height, role: "img", "aria-label": inWords(view, steps) });
  const box = { x: LEFT, y: top, width: PAPER - LEFT - RIGHT, height: high };
  const over = element("svg", { class: "time", ...box, viewBox: Object.values(box).join(" "), preserveAspectRatio: "none" });
  svg.append(over);
  shadeOutages(over, steps, x, tops);
  tiers.forEach((tier, row) => drawTier(svg, over, tier, tops.tiers + row * TIER, steps, x));
  drawRow(svg, over, { name: "stored (%)", top: tops.store, kind: "store", most: 1, least: 0, label: (v) => Math.round(100 * v) },
    steps.map((step) => [[step.end, step.stored]]), steps, x);
  drawImport(svg, over, tops.import, steps, x);
  drawStrip(svg, tops.strip, steps, x);
  over.append(element("line", { class: "edge", x1: LEFT, x2: PAPER - RIGHT, y1: bottom, y2: bottom }));
  for (const line of dated ? [0, 1] : [0]) svg.append(element("text", { class: "at tick", x: LEFT, y: bottom + 16 + 13 * line }));
  const now = x(Math.min(last, Math.max(first, view.now)));
  over.append(element("line", { class: "now", x1: now, x2: now, y1: TOP - 4, y2: bottom }));
  svg.append(element("text", { class: "now-word at", x: Math.min(now, PAPER - RIGHT - 14), y: 12, "text-anchor": "middle" }, "now"));
  return { svg, first, last, ...read(view, steps, first, Math.round((last - first) / length), length), top: TOP, bottom };
}

// Values by step, each with its words; a step that is not known has none.
function read(view, steps, first, count, length) {
  const slots = Array(count).fill(null);
  steps.forEach((step) => { slots[Math.round((step.begin - first) / length)] = step; });
  const times = slots.map((_, t) => `${view.clock.day.format(first + t * length)} ${view.clock.hm.format(first + t * length)} ${view.clock.zone(first + t * length)}`);
  const said = (name, words) => ({ name, color: "transparent", values: slots.map((step) => (step?.decided ? words(step) : "")) });
  const known = (value, words) => (value === null || value === undefined ? "" : words(value));
  const curves = [
    ...view.site.tiers.map((tier) => said(`${tier} supplied`, (step) => percent(step.served[tier] ?? 1))),
    said("stored", (step) => known(step.stored, percent)), said("import (kW)", (step) => known(step.import, kilo)), said("", (step) => (step.status === "ok" ? "" : step.status)),
  ];
  return { times, outages: spansOf(slots.map((step) => step?.limit === 0)), curves };
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

function drawTier(svg, over, tier, top, steps, x) {
  const tall = TIER - 6;
  svg.append(element("text", { class: "name", x: LEFT - 8, y: top + 14, "text-anchor": "end" }, shortened(tier)));
  for (const step of steps.filter((one) => one.decided)) {
    const wide = Math.max(1, x(step.end) - x(step.begin) - 1);
    const share = Math.round(1e6 * step.served[tier]) / 1e6, least = LEAST / tall; // one customer of twelve is to be seen
    const on = tall * (share > 0 && share < 1 ? Math.min(1 - least, Math.max(least, share)) : share);
    const ahead = step.ahead ? " ahead" : "";
    if (on < tall) over.append(element("rect", { class: `off${ahead}`, x: x(step.begin), y: top, width: wide, height: tall - on }));
    if (on > 0) over.append(element("rect", { class: `on${ahead}`, x: x(step.begin), y: top + tall - on, width: wide, height: on }));
  }
}

const shortened = (name) => (name.length > 10 ? `${name.slice(0, 9)}\u2026` : name);

function drawImport(svg, over, top, steps, x) {
  const drawn = steps.map((step) => step.import ?? 0);
  const most = rounded(Math.max(...drawn, 2)), least = 0 - rounded(Math.max(...drawn.map((value) => -1 - value), 0));
  const row = { name: "import (kW)", top, kind: "import", most, least, label: kilo };
  drawRow(svg, over, row, steps.map((step) => [[step.begin, step.import], [step.end, step.import]]), steps, x);
  const y = (value) => top + ROW * (1 - (value - least) / (most - least));
  for (const step of steps.filter((one) => one.limit > 0 && one.limit <= most)) {
    over.append(element("line", { class: "limit", x1: x(step.begin), x2: x(step.end), y1: y(step.limit), y2: y(step.limit) }));
  }
}

// The next round number: 1, 2 or 5 times a power of ten.
function rounded(value) {
  if (value <= 0) return 0;
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 1.5, 2, 3, 5, 7.5, 10].find((factor) => factor * power >= value);
}

function drawRow(svg, over, row, points, steps, x) {
  const y = (value) => row.top + ROW * (1 - (value - row.least) / (row.most - row.least));
  svg.append(element("text", { class: "name", x: LEFT, y: row.top - 7 }, row.name));
  for (const value of row.least < 0 ? [row.least, 0, row.most] : [row.least, (row.least + row.most) / 2, row.most]) {
    over.append(element("line", { class: "grid", x1: LEFT, x2: PAPER - RIGHT, y1: y(value), y2: y(value) }));
    svg.append(element("text", { x: LEFT - 8, y: y(value) + 4, "text-anchor": "end" }, row.label(value)));
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
    if (path) over.append(element("path", { class: `curve ${row.kind}${ahead ? " ahead" : ""}`, d: path }));
  }
}

// Below: steps with exceptions.
function drawStrip(svg, top, steps, x) {
  const signs = { fallback: ["odd", "F"], off: ["odd", "0"], hold: ["odd", "H"], manual: ["odd", "M"], failed: ["bad", "!"], missed: ["bad", "\u00d7"] };
  for (const step of steps) {
    const sign = signs[step.status];
    if (!sign) continue;
    const words = element("title", {}, `${step.status}${step.reason ? `: ${step.reason}` : ""}`);
    svg.append(element("text", { class: `${sign[0]} at`, x: (x(step.begin) + x(step.end)) / 2, y: top + 11, "text-anchor": "middle" }, sign[1], words));
  }
}
