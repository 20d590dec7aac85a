// Polls the service every two seconds and shows its state. Nothing is fetched from other hosts.

import { chart, meter, pastOf, stepsOf } from "./chart.js";
import { Operator } from "./operator.js";
import {
  HOUR, MARKS, MINUTE, SiteClock, alarms, announced, announcesNothing, attention, counted, covers, facts, farthestOutside, fuelLasts, fuelNow, grouped, indoorNow, isHeard, isLostByReading, isUncertain, kilo, lasting, lateBy, list, lowest, offByTier, oldSoc, onPhase, percent, socNow, sourceState, switchedNext, switching, unawareOfLoss, verdict, why,
} from "./words.js";

const EVERY_MS = 2000, PATIENCE_MS = 5000;
const CHANGE_PATIENCE_MS = 30000; // a change waits for the disk
const WHY_PATIENCE_MS = 125000;
const SHELF_H = 4; // of a shift; over HTTP an alarm is shelved for as long as you ask
const LOST_MS = 10000; // without an answer, after which the page shows that it is out of date

const KNOWN_BY = { reading: ", measured", "last reading": ", last measured", event: ", announced", belief: ", most likely", limit: ", by a limit of import", profile: ", by profile" };

const $ = (id) => document.getElementById(id);
let token = null; // in memory alone
const view = { site: null, overview: null, clock: new SiteClock("UTC"), now: new Date(), heard: new Date(), lost: false };
let heardAt = performance.now(); // on this machine's monotonic clock

async function ask(path, options = {}, patience_ms = options.method ? CHANGE_PATIENCE_MS : PATIENCE_MS) {
  const headers = { "Content-Type": "application/json", ...(token && { Authorization: `Bearer ${token}` }), ...options.headers };
  const answer = await fetch(path, { ...options, headers, cache: "no-store", signal: AbortSignal.timeout(patience_ms) })
    .catch((error) => { throw Object.assign(new Error(error.message), { unanswered: true }); });
  const body = await answer.json().catch(() => ({}));
  if (!answer.ok) throw Object.assign(new Error(body.detail ?? `The service answers ${answer.status}.`), { status: answer.status });
  return body;
}

async function look() {
  try {
    if (!view.site) {
      view.site = await ask("v1/site");
      view.clock = new SiteClock(view.site.time_zone);
      operator.offer(view.site);
    }
    view.overview = await ask("v1/overview");
    heardAt = performance.now();
    view.heard = new Date(view.overview.now);
    wantToken(null);
    learnWhy();
    learnHistory();
  } catch (error) {
    if (error.status === 401 || error.status === 403) wantToken(error.message);
  }
  show();
}

// The service works out the reasons at the first request: once for each plan.
let asking = false;
async function learnWhy() {
  const { plan } = view.overview;
  const keeps = (plan?.solve?.stored_value_gbp_per_kwh ?? null) !== null;
  if (asking || !(plan?.off.length || keeps) || view.why?.plan === plan.id) return;
  asking = true;
  try {
    view.why = await ask("v1/explanations", {}, WHY_PATIENCE_MS);
    show();
  } catch { /* it is asked again when the page looks again */ }
  asking = false;
}

// Steps before those of the overview, once for each new step.
async function learnHistory(anew = false) {
  const hours = Number($("history-hours").value), last = view.overview.past.at(-1)?.start;
  if (!anew && (!hours || view.historyOf === last)) return;
  view.historyOf = last;
  const since = new Date(view.now.getTime() - hours * HOUR).toISOString();
  view.history = hours ? (await ask(`v1/history?since=${since}`, {}, WHY_PATIENCE_MS).catch(() => ({ steps: [] }))).steps : [];
  show();
}
$("history-hours").addEventListener("change", () => learnHistory(true));

function wantToken(words) {
  if (words === null) {
    $("token").hidden = true;
    $("token-other").hidden = token === null;
    return;
  }
  if ($("token").hidden) {
    $("token").hidden = false;
    $("token-text").focus();
  }
  $("token-words").textContent = token === null ? "Enter a token to use this service." : words;
}

$("token").addEventListener("submit", (event) => {
  event.preventDefault();
  token = $("token-text").value.trim();
  $("token-text").value = "";
  look();
});
$("token-other").addEventListener("click", () => { $("token").hidden = false; $("token-text").focus(); });

// A clock that a client sets does not advance by itself.
function tell() {
  const since = performance.now() - heardAt;
  view.lost = since > LOST_MS;
  view.now = new Date(view.heard.getTime() + (view.site?.played ? 0 : since));
  return since;
}

function write(id, text) {
  const place = typeof id === "string" ? $(id) : id;
  if (place.textContent !== text) place.textContent = text; // else a screen reader says it again
}

function node(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function show() {
  const since = tell();
  document.body.classList.toggle("lost", view.lost);
  const [level, words, more] = verdict(view);
  $("verdict").className = level;
  write("verdict-mark", MARKS[level]);
  write("verdict-words", words);
  write("verdict-facts", facts(view));
  write("verdict-more", more ?? "");
  write("contact", view.lost ? "\u2716 no contact" : view.overview ? `live, ${since < 3500 ? "just now" : `${lasting(since)} ago`}` : "");
  if (!view.overview) return;
  write("site", `${view.site.title}${view.site.played ? " (clock set by a client)" : ""}`);
  write("clock", view.clock.full.format(view.now));
  document.title = `${MARKS[level]} ${words} ${view.site.name}`;
  const { mode } = view.overview.mode;
  write("mode", `Mode: ${mode}`);
  $("mode").className = mode === "auto" ? "" : "unusual";
  operator.show(mode);
  $("watched").hidden = false;
  showAttention();
  showFigures();
  showChart();
  showOff();
  showBatteries();
  showVehicles();
  showRooms();
  showSets();
  showSources();
  showEvents();
  showSwitching();
  showSteps();
}

// Rebuilds a part only if its content changed, so that focus and screen readers are not disturbed, and
// not while something in it is pressed: its release would find another button, and do nothing.
const shown = new Map();
function renew(id, content, build) {
  const key = JSON.stringify(content);
  if (shown.get(id) === key || $(id).matches(":active")) return;
  shown.set(id, key);
  $(id).replaceChildren(...build());
}

function showAttention() {
  const raised = alarms(view), notes = attention(view);
  const items = [...raised.map(([level, text, known, alarm]) => alarmItem(level, text, known, alarm)), ...notes.map(([level, text]) => item(level, text))];
  renew("attention-list", [raised, notes, isHeard(view)], () => (items.length ? items : [isHeard(view) ? item("fine", "No action needed.") : item("note", "No reading is in time.")]));
}

function item(level, text, ...more) {
  return node("li", { class: level }, node("span", { "aria-hidden": "true" }, MARKS[level]), node("div", {}, text, ...more));
}

function alarmItem(level, text, known, alarm) {
  const buttons = [];
  const button = (words, method, path, body) => {
    const made = node("button", { type: "button", class: "quiet", "aria-label": `${words}: ${text}` }, words);
    made.addEventListener("click", () => operator.act(`v1/alarms/${alarm.id}/${path}`, method, body));
    buttons.push(made);
  };
  if (!alarm.acknowledged_at) button("Acknowledge", "POST", "acknowledge", () => ({}));
  if (alarm.state === "shelved") button("Unshelve", "DELETE", "shelf");
  else if (!alarm.cleared_at) button(`Shelve for ${SHELF_H} h`, "PUT", "shelf", () => ({ until: operator.after(SHELF_H).toISOString() }));
  return item(level, node("b", {}, text), node("p", { class: "known" }, known), node("span", { class: "row" }, ...buttons));
}

function figure(title, value, unit, bar, ...notes) {
  return node("div", { class: "figure card" }, node("h2", {}, title),
    node("p", { class: "value" }, value, " ", node("span", { class: "unit" }, unit)), ...(bar ? [bar] : []),
    ...notes.filter(Boolean).map((note) => node("p", { class: "note" }, note)));
}

function showFigures() {
  const { plan, measured, sources } = view.overview;
  const content = [plan, measured, sources, view.lost, isUncertain(view), Math.floor(view.now / 60000)];
  renew("figures", content, () => [customersFigure(), storedFigure(), importFigure(), voltageFigure(), ...vehiclesFigure(), ...roomsFigure(), ...phasesFigure()]);
}

function customersFigure() {
  const off = offByTier(view), all = Object.values(view.site.customers);
  const n = Object.values(off).reduce((a, b) => a + b, 0);
  const tiers = view.site.tiers.map((tier) => [tier, all.filter((one) => one === tier).length]).filter(([, many]) => many);
  const notes = tiers.map(([tier, many]) => `${tier} ${many - off[tier]} of ${many}`);
  return figure(isUncertain(view) ? "Customers connected" : "Customers supplied", String(all.length - n), `of ${all.length}`,
    meter((all.length - n) / all.length, { rest: "over", name: `${all.length - n} of ${all.length} customers connected` }), notes.join(" \u00b7 "), isUncertain(view) ? "Supply is uncertain." : "");
}

function storedFigure() {
  let held = 0, usable = 0, all = 0, least = 0, discharged = 0;
  for (const [name, b] of Object.entries(view.site.batteries)) {
    const soc = socNow(view, name);
    if (soc === null) continue;
    held += soc * b.energy_kwh;
    usable += Math.max(0, soc - b.soc_min) * b.energy_kwh;
    all += b.energy_kwh;
    least += b.soc_min * b.energy_kwh;
    discharged -= view.overview.plan?.batteries[name]?.p_kw ?? 0;
  }
  if (!all) return figure("Stored energy", "\u2013", "kWh", null, "No battery data.");
  const power = discharged > 0.5 ? `discharging ${kilo(discharged)} kW` : discharged < -0.5 ? `charging ${kilo(-discharged)} kW` : "idle";
  const low = lowest(view), late = Math.max(...Object.keys(view.site.batteries).map((name) => lateBy(view, name) ?? 0));
  return figure("Stored energy", kilo(held), `kWh, ${percent(held / all)}`,
    meter(held / all, { kind: "store", marks: [least / all], name: `${percent(held / all)}, lower limit ${percent(least / all)}` }),
    `${kilo(usable)} kWh above the lower limit; ${power}`, late ? oldSoc(view, late, "read up to") : "", low && low.share < held / all - 0.005 ? `planned: ${percent(low.share)} at ${view.clock.at(low.time, view.now)}` : "");
}

function importFigure() {
  const expected = view.overview.plan?.expected, reading = view.overview.measured["import_kw grid"];
  const limit = expected?.grid_limit_kw ?? null;
  const value = expected?.import_kw ?? reading?.value ?? null;
  if (unawareOfLoss(view) || isLostByReading(view)) return figure("Import", "0", "kW", null, "no grid, measured");
  if (value === null) return figure("Import", "\u2013", "kW", null, "No data.");
  const marks = limit ? [1 / 1.25] : [];
  const bar = limit ? meter(value / (1.25 * limit), { marks, kind: value > 1.01 * limit ? "over" : "", name: `${percent(value / limit)} of the limit` }) : null;
  const words = limit === 0 ? `no grid${KNOWN_BY[view.overview.plan?.grid?.known_by] ?? ""}` : limit === null ? "no limit" : `limit ${kilo(limit)} kW`;
  const metered = reading && reading.value !== null ? `measured ${kilo(reading.value)} kW at ${view.clock.at(reading.at, view.now)}` : "";
  return figure(value < -0.5 ? "Export" : "Import", kilo(Math.abs(value)), "kW", bar, words, metered);
}

function voltageFigure() {
  const { v_min_pu: low, v_max_pu: high } = view.site;
  const expected = view.overview.plan?.expected;
  if (view.overview.plan?.dark) return figure("Lowest voltage", "\u2013", "pu", null, "No voltage: the island is blacked out.");
  if (unawareOfLoss(view)) return figure("Lowest voltage", "\u2013", "pu", null, "The plan counts on the grid.");
  if (!expected || expected.v_min_pu === null) return figure("Lowest voltage", "\u2013", "pu", null, "No data.");
  const span = high - low, place = (value) => (value - low + 0.15 * span) / (1.3 * span);
  const inside = expected.v_min_pu >= low && expected.v_max_pu <= high;
  return figure("Lowest voltage", expected.v_min_pu.toFixed(3), "pu",
    meter(place(expected.v_max_pu), { from: place(expected.v_min_pu), kind: inside ? "" : "over", marks: [place(low), place(high)], name: inside ? "within limits" : "outside limits" }),
    `${expected.v_min_bus ? `at bus ${expected.v_min_bus}; ` : ""}highest ${expected.v_max_pu.toFixed(3)}, limits ${low} to ${high}`);
}

// What the grid, or the battery that holds the island, gives on each phase; nothing for a balanced feeder.
function phasesFigure() {
  if (!view.site.phases) return [];
  const found = view.overview.plan?.expected?.phases;
  if (!found) return [figure("Phases", "\u2013", "kVA", null, "No data.")];
  const { source, source_kva: kva, rating_kva: rating, v_pu, unbalance_max: unbalance, nearest } = found;
  const [phase] = Object.entries(kva).sort((one, other) => other[1] - one[1])[0], most = kva[phase];
  const bar = rating ? meter(most / (1.25 * rating), { marks: [1 / 1.25], kind: most > 1.01 * rating ? "over" : "", name: `${percent(most / rating)} of a phase's rating` }) : null;
  const readings = Object.fromEntries(Object.keys(kva).map((name) => [name, view.overview.measured[`source_kva/${name} ${source}`]]));
  const read = (name) => readings[name]?.value, last = Object.values(readings).find((one) => Number.isFinite(one?.value));
  const rows = Object.entries(v_pu).map(([name, [low, high]]) =>
    [name, name in kva ? kilo(kva[name]) : "\u2013", Number.isFinite(read(name)) ? kilo(read(name)) : "\u2013", low.toFixed(3), high.toFixed(3)]);
  const place = nearest.at === source ? `of ${source}` : `at bus ${nearest.at}`;
  const made = figure(source === "grid" ? "Import by phase" : `${source} by phase`, kilo(most), rating ? `of ${kilo(rating)} kVA on phase ${phase}` : `kVA on phase ${phase}`, bar,
    `Nearest its limit: phase ${nearest.phase} ${place}, ${percent(nearest.share)}. Voltage unbalance ${(100 * unbalance).toFixed(1)}%.`);
  made.classList.add("phases");
  made.append(node("table", {}, ...table(["Phase", "kVA", last ? `measured at ${view.clock.at(last.at, view.now)}` : "measured", "lowest (pu)", "highest (pu)"], rows)));
  return [made];
}

// Vehicles that will leave with less than they need; nothing without chargers.
function vehiclesFigure() {
  const chargers = Object.keys(view.site.chargers);
  if (!chargers.length) return [];
  const { plan } = view.overview, here = Object.keys(plan?.expected?.vehicles ?? {});
  if (!plan?.expected) return [figure("Vehicles", "\u2013", "", null, "No data.")];
  const short = Object.values(plan.ahead?.left_short ?? {});
  const charging = Object.values(plan.chargers).reduce((sum, one) => sum + one.p_kw, 0);
  const power = charging > 0.05 ? `charging ${kilo(charging)} kW` : charging < -0.05 ? `giving ${kilo(-charging)} kW back` : "none charging";
  return [figure("Vehicles", String(here.length), `at ${counted(chargers.length, "charger")}`, null, power, short.length ? shortWords(short) : "None will leave short in this plan.")];
}

function shortWords(short) {
  const each = short.map((one) => `${one.vehicle} at ${view.clock.at(one.leaves, view.now)} (${one.short_kwh.toFixed(1)} kWh)`);
  return `${counted(short.length, "vehicle")} will leave short: ${list(each)}`;
}

// Rooms and tanks outside their comfort band, now or by the plan; nothing without any.
function roomsFigure() {
  const names = Object.keys(view.site.thermal_loads);
  if (!names.length) return [];
  const known = names.filter((name) => indoorNow(view, name).value !== null);
  const outside = known.map((name) => [name, farthestOutside(view, name)]).filter(([, most]) => most).sort((one, other) => other[1].by - one[1].by);
  const now = known.filter((name) => inBand(name)).length;
  const words = outside.map(([name, most]) => `${name} ${most.value.toFixed(1)} \u00b0C${most.time > view.now ? ` at ${view.clock.at(most.time, view.now)}` : " now"}`);
  return [figure("Rooms in their band", String(now), `of ${names.length}`, meter(now / names.length, { rest: "over", name: `${now} of ${names.length} in their comfort band` }),
    words.length ? `${outside.length} outside now or by the plan: ${list(words)}` : "All stay in their band by the plan.")];
}

function inBand(name) {
  const { t_min_c: low, t_max_c: high } = view.site.thermal_loads[name], { value } = indoorNow(view, name);
  return value >= low - 0.05 && value <= high + 0.05;
}

function showChart() {
  const { plan } = view.overview, past = pastOf(view);
  let drawn = null;
  renew("chart", [past, plan?.ahead, Math.floor(view.now / 60000)], () => {
    drawn = chart(view);
    return drawn ? [drawn.svg] : [node("p", { class: "note" }, "No step has been decided yet.")];
  });
  if (drawn) readChart(drawn);
  renew("chart-table", [past, plan?.ahead], () => chartTable());
}

// The chart is read and drawn out as in a report; what is drawn out stays while steps come.
let charts = null, shownFrom = null, shownTo = null;
function readChart(drawn) {
  charts = new Pictures.Charts(drawn.times, drawn.outages);
  charts.add($("chart"), drawn);
  const share = (time) => Math.min(1, Math.max(0, (time - drawn.first) / (drawn.last - drawn.first)));
  const now = Math.floor(share(view.now) * drawn.times.length);
  charts.chosen = Math.min(now, drawn.times.length - 1);
  if (shownFrom !== null && share(shownTo) > share(shownFrom)) [charts.from, charts.to] = [share(shownFrom), share(shownTo)];
  charts.onZoom = (from, to) => {
    const time = (one) => drawn.first + one * (drawn.last - drawn.first);
    [shownFrom, shownTo] = to - from < 1 ? [time(from), time(to)] : [null, null];
  };
  charts.fit();
}

function table(heads, rows) {
  return [node("thead", {}, node("tr", {}, ...heads.map((head) => node("th", { scope: "col" }, head)))),
    node("tbody", {}, ...rows.map(([first, ...rest]) => node("tr", {}, node("th", { scope: "row" }, first), ...rest.map((cell, i) => node("td", { "data-head": heads[i + 1] }, cell)))))];
}

function chartTable() {
  const tiers = view.site.tiers;
  const known = (value, words) => (value === null || value === undefined ? "\u2013" : words(value));
  return table(["Step", "State", ...tiers.map((tier) => `${tier} supplied`), "Stored", "Import (kW)", "Limit (kW)"],
    stepsOf(view).map((step) => [view.clock.at(step.begin, view.now), step.status, ...tiers.map((tier) => (step.decided ? percent(step.served[tier] ?? 1) : "\u2013")),
      known(step.stored, percent), known(step.import, kilo), step.decided ? known(step.limit, kilo) : "\u2013"]));
}

function timeOff({ asset, off_h, longest_off_h }) {
  return off_h === null || longest_off_h === null ? onPhase(asset, view.site) : `${asset} (off ${off_h} h of ${longest_off_h} h)`;
}

function showOff() {
  const { off = [], dimmed = {}, status, id, dark, solve } = view.overview.plan ?? {};
  const explained = view.why?.plan === id ? view.why : null;
  renew("off-list", [off, dark, dimmed, status, solve?.shorter, isUncertain(view), explained, view.overview.now.slice(0, 13)], () => {
    const parts = Object.entries(dimmed).map(([asset, share]) => `${asset} to ${Math.round(100 * share)}%`);
    const below = parts.length ? [node("p", {}, `Dimmed: ${list(parts, 12)}.`)] : [];
    // Without a phase it is the plan's words again.
    const step = explained?.phase && !dark ? explained.step.words : off.length ? "" : isUncertain(view) ? "Supply is uncertain." : "All customers supplied.";
    if (step) below.unshift(node("p", {}, step));
    if (solve?.shorter && !dark) below.push(node("p", {}, `A lower tier is on while a higher one waits: ${solve.shorter}.`));
    if (!off.length) return below;
    const told = off.map((one) => ({ ...one, why: why(one, explained, status) }));
    const groups = grouped(told, (one) => JSON.stringify([one.tier, one.why.short, one.until]));
    const rows = [...groups].map(([key, ones]) => [JSON.parse(key), ones]);
    rows.sort((a, b) => view.site.tiers.indexOf(a[0][0]) - view.site.tiers.indexOf(b[0][0]));
    return [node("table", {}, ...table(["Tier", "Customers", "Why", "Estimated restoration"],
      rows.map(([[tier, reason, until], ones]) => [tier, node("span", { class: "names" }, `${ones.length}: ${list(ones.map(timeOff), 12)}`),
        ones.length === 1 ? ones[0].why.words : reason, until ? view.clock.at(until, view.now) : "beyond the plan"]))), ...below];
  });
}

// A device in a list: what it holds, what it does, and what to know of it.
function device(name, held, level, words, ...notes) {
  return node("li", {}, node("b", {}, name), node("span", { class: "n" }, held), level, node("span", { class: "note" }, words),
    ...notes.filter(Boolean).map((note) => node("span", { class: "late note" }, note)));
}

const defaulted = (point) => (point?.reason.startsWith("default") ? point.reason : "");

function showBatteries() {
  document.getElementById("batteries-former").textContent = view.site.former;
  const { plan, measured, sources } = view.overview;
  const all = Object.entries(view.site.batteries);
  const key = [plan?.batteries, sources, all.map(([name]) => measured[`soc ${name}`]), plan?.id, Math.floor(view.now / 60000)];
  renew("batteries-list", key, () => all.map(([name, b]) => {
    const soc = socNow(view, name), point = plan?.batteries[name], reading = measured[`soc ${name}`];
    const power = point?.p_kw ?? 0;
    const words = power > 0.05 ? `\u25b2 charging ${power.toFixed(1)} kW` : power < -0.05 ? `\u25bc discharging ${(-power).toFixed(1)} kW` : "idle";
    const late = lateBy(view, name);
    const old = !reading || reading.value === null ? "no reading" : late === null ? "" : oldSoc(view, late);
    const level = meter(soc ?? 0, { kind: "store", marks: [b.soc_min, b.soc_max], name: `limits ${percent(b.soc_min)} to ${percent(b.soc_max)}` });
    return device(onPhase(name, view.site), soc === null ? "no data" : percent(soc), level, words, defaulted(point), old);
  }));
}

function showVehicles() {
  const { plan, measured } = view.overview, names = Object.keys(view.site.chargers);
  $("vehicles").hidden = !names.length;
  const here = plan?.expected?.vehicles ?? {}, short = plan?.ahead?.left_short ?? {};
  const gone = (name) => measured[`plugged ${name}`]?.value === 0 && new Date(measured[`plugged ${name}`].at) > new Date(plan.valid_from ?? plan.start);
  renew("vehicles-list", [here, short, plan?.chargers, names.map(gone), Math.floor(view.now / 60000)], () => Object.entries(here).map(([name, one]) => {
    const power = plan.chargers[name]?.p_kw ?? 0;
    const words = power > 0.05 ? `\u25b2 charging ${power.toFixed(1)} kW` : power < -0.05 ? `\u25bc giving ${(-power).toFixed(1)} kW` : "not charging";
    const held = one.energy_kwh.toFixed(1), needed = one.needed_kwh.toFixed(1);
    const level = meter(one.energy_kwh / Math.max(one.needed_kwh, 0.001), { kind: "store", name: `${held} of ${needed} kWh that it needs` });
    return device(one.vehicle, `${held} kWh`, level, `${words}; needs ${needed} kWh by ${view.clock.at(one.leaves, view.now)}`,
      short[name] ? `will leave ${short[name].short_kwh.toFixed(1)} kWh short` : "", gone(name) ? "unplugged since the plan" : "", defaulted(plan.chargers[name]));
  }));
  const empty = names.filter((name) => !(name in here));
  write("vehicles-none", empty.length ? `Without a vehicle: ${list(empty, 12)}.` : "");
}

const ROOM_SPAN_C = 4; // shown beyond both ends of the comfort band

function showRooms() {
  const { plan, measured, sources } = view.overview, all = Object.entries(view.site.thermal_loads);
  $("rooms").hidden = !all.length;
  const key = [plan?.thermal_loads, plan?.expected?.indoor_c, plan?.estimated, sources, all.map(([name]) => measured[`indoor_c ${name}`]), Math.floor(view.now / 60000)];
  renew("rooms-list", key, () => all.map(([name, { t_min_c: low, t_max_c: high }]) => {
    const { value, old } = indoorNow(view, name), point = plan?.thermal_loads[name];
    const span = high - low + 2 * ROOM_SPAN_C, place = (t_c) => (t_c - low + ROOM_SPAN_C) / span;
    const level = meter(value === null ? 0 : place(value), { kind: value === null || inBand(name) ? "" : "over", marks: [place(low), place(high)], name: `comfort band ${low} to ${high} \u00b0C` });
    return device(name, value === null ? "no data" : `${value.toFixed(1)} \u00b0C`, level, point ? `set to ${point.setpoint_c.toFixed(1)} \u00b0C` : "no set-point", defaulted(point), old);
  }));
}

function showSets() {
  const { plan, measured, sources } = view.overview, all = Object.entries(view.site.gensets);
  $("gensets").hidden = !all.length;
  const key = [plan?.gensets, plan?.expected?.gensets, plan?.ahead?.genset_kw, plan?.estimated, sources, all.map(([name]) => [measured[`fuel_litres ${name}`], measured[`running ${name}`]]), Math.floor(view.now / 60000)];
  renew("gensets-list", key, () => all.map(([name, set]) => {
    const { value, old } = fuelNow(view, name), point = plan?.gensets[name], next = switchedNext(view, name), tank = set.tank_litres;
    const runs = measured[`running ${name}`]?.value, read = runs === 1 ? "running" : runs === 0 ? "off" : "state not read";
    const told = !point ? "no set-point" : point.running ? `ordered ${point.p_kw.toFixed(1)} kW` : "ordered off";
    const then = next ? `; ${next.starts ? "starts" : "stops"} at ${view.clock.at(next.time, view.now)}` : "";
    const lasts = value === null ? "" : `; fuel for ${fuelLasts(set, value, (point?.running && point.p_kw) || set.p_max_kw)}`;
    const level = meter((value ?? 0) / tank, { kind: "store", name: `${kilo(value ?? 0)} of ${kilo(tank)} l` });
    return device(name, value === null ? "no data" : `${kilo(value)} l`, level, `${read}; ${told}${then}${lasts}`,
      plan?.expected?.gensets?.[name]?.out ? "out: it does not start" : "", defaulted(point), old);
  }));
}

function showSources() {
  const { sources } = view.overview;
  renew("sources-table", [sources, Math.floor(view.now / 5000)], () => sources.length
    ? table(["Source", "Last contact", "State"], sources.map((one) => {
      const [level, words] = sourceState(one);
      return [one.source, `${lasting(view.now - new Date(one.last_contact))} ago`, node("span", { class: level }, words)];
    }))
    : table(["Source"], [["No source connected."]]));
}

// The order of switching: what is carried out, what waits for an operator, and what comes then.
function showSwitching() {
  const found = switching(view);
  $("switching").hidden = !found;
  if (!found) return;
  renew("switching-list", found.operations, () => found.operations.map((words) => node("li", {}, words)));
  write("switching-words", found.words);
  const box = $("switching-confirm");
  if (box.hidden || box.dataset.next !== found.next) box.open = false;
  box.hidden = !found.next;
  box.dataset.next = found.next;
  write("switching-next", `Confirm: ${found.next}`);
  write("switching-yes", `Yes, ${found.next} now`);
}

function showEvents() {
  const events = Object.entries(view.overview.events).filter(([, event]) => !event.end || new Date(event.end) > view.now);
  renew("events-list", [events, announcesNothing(view), Math.floor(view.now / 60000)], () => events.length
    ? events.map(([name, event]) => node("li", {}, announced(event, view), " ", node("span", { class: "note" }, `${name}, ${event.source ?? ""}${covers(event, view.now) ? ", now" : ""}`)))
    : [node("li", {}, announcesNothing(view))]);
}

function showSteps() {
  const { steps } = view.overview, past = pastOf(view);
  const rank = ([name]) => view.site.tiers.indexOf(view.site.customers[name]);
  const within = (step) => Object.entries(step.off_min ?? {}).sort((a, b) => rank(a) - rank(b));
  const odd = past.filter((step) => step.status !== "ok" || step.refused.length || within(step).length).reverse();
  renew("steps-list", [odd, view.overview.now.slice(0, 10)], () => odd.length
    ? odd.map((step) => node("li", {}, node("b", {}, `${view.clock.at(step.start, view.now)} ${step.status}`),
      `${step.fallback ? `, ${step.fallback.replaceAll("_", " ")}` : ""}${step.reason ? `: ${step.reason}` : ""}`,
      within(step).length ? `. Off for a part of the step: ${list(within(step).map(([name, minutes]) => `${name} ${lasting(minutes * MINUTE)}`))}` : "",
      step.refused.length ? `. Rejected: ${list(step.refused.map((one) => `${one.asset} ${one.reason}`))}` : ""))
    : [node("li", {}, "None in recent hours.")]);
  write("steps-counts", `Since the start: ${Object.entries(steps).filter(([, n]) => n).map(([outcome, n]) => `${n} ${outcome}`).join(", ") || "no step"}.`);
}

const operator = new Operator(ask, look, () => view.now, () => view);
$("switching-yes").addEventListener("click", () => {
  const { path, method, body, seen } = switching(view);
  operator.act(path, method, () => body, "switching-said", { "If-Match": seen });
});
new ResizeObserver(() => charts?.fit()).observe($("outlook"));
setInterval(show, 1000);
(async function watch() {
  await look();
  setTimeout(watch, EVERY_MS);
})();
