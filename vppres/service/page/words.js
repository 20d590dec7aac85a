// The text of the page: an overview in, sentences out. Nothing here touches the page.

export const ALARM = "alarm", WARNING = "warning", NOTE = "note", FINE = "fine";
const RANK = { [ALARM]: 0, [WARNING]: 1, [NOTE]: 2 };
export const MARKS = { [ALARM]: "\u25a0", [WARNING]: "\u25b2", [NOTE]: "\u25cb", [FINE]: "\u25cf" };

export const SECOND = 1000, MINUTE = 60 * SECOND, HOUR = 60 * MINUTE;
const BAND_C = 0.05; // what is shown as 26.0 is not above 26
const NAMED_HERE = 3; // assets of a kind, before "and n more"

// Times by the clocks at the site; the zone is named if it differs from the current one.
export class SiteClock {
  constructor(zone) {
    const format = (options) => new Intl.DateTimeFormat("en-GB", { timeZone: zone, hourCycle: "h23", ...options });
    const hm = { hour: "2-digit", minute: "2-digit" };
    this.hm = format(hm);
    this.full = format({ weekday: "short", day: "numeric", month: "short", ...hm, timeZoneName: "short" });
    this.day = format({ weekday: "short", day: "numeric", month: "short" });
    this.weekday = format({ weekday: "short" });
    this.named = format({ timeZoneName: "short" });
  }
  zone(time) { return this.named.formatToParts(time).find((part) => part.type === "timeZoneName").value; }
  at(time, now) {
    const t = new Date(time);
    const day = this.day.format(t) === this.day.format(now) ? "" : `${this.weekday.format(t)} `;
    const zone = this.zone(t) === this.zone(now) ? "" : ` ${this.zone(t)}`;
    return `${day}${this.hm.format(t)}${zone}`;
  }
}

export function lasting(ms) {
  if (ms < 90 * SECOND) return `${Math.max(0, Math.round(ms / SECOND))} s`;
  if (ms < 90 * MINUTE) return `${Math.round(ms / MINUTE)} min`;
  const hours = Math.floor(ms / HOUR), minutes = Math.round((ms % HOUR) / MINUTE);
  if (hours >= 48) return `${Math.round(ms / (24 * HOUR))} days`;
  return minutes % 60 ? `${hours} h ${minutes} min` : `${Math.round(ms / HOUR)} h`;
}

export const kilo = (value) => Math.round(value).toLocaleString("en-GB");
export const percent = (share) => `${Math.round(100 * share)}%`;
export const counted = (n, one, many = `${one}s`) => `${n.toLocaleString("en-GB")} ${n === 1 ? one : many}`;
export const list = (names, most = NAMED_HERE) =>
  names.length <= most + 1 ? names.join(", ") : `${names.slice(0, most).join(", ")} and ${names.length - most} more`;

// A device with its phase, if it is not on all three.
export function onPhase(name, site) {
  const coils = (site.phases?.[name] ?? "").split(" ");
  return coils.length >= 3 || !coils[0] ? name : `${name} (phase\u00a0${coils.join(" and ")})`;
}

// The current outage, if there is one: from an event, or from the plan.
export function outage(view) {
  const { plan, events } = view.overview;
  const known = Object.values(events).filter((event) => event.type === "outage" && covers(event, view.now));
  const dark = plan?.active && (plan.grid?.available === false || plan.expected?.grid_limit_kw === 0 || isLostByReading(view));
  if (!known.length && !dark) return null;
  const ends = known.map((event) => event.end).filter(Boolean).sort();
  if (known.length) return { end: ends.length === known.length ? ends.at(-1) : null, known: true };
  const back = plan.ahead?.grid_limit_kw.findIndex((limit) => limit !== 0) ?? -1;
  return { end: back < 0 ? null : plan.ahead.times[back], known: false };
}

export const covers = (event, now) =>
  new Date(event.start) <= now && (!event.end || now < new Date(event.end));

export function offByTier(view) {
  const off = Object.fromEntries(view.site.tiers.map((tier) => [tier, 0]));
  for (const one of view.overview.plan?.off ?? []) off[one.tier] += 1;
  return off;
}

// The reading of the grid, if there is one: {value, at, source}.
const gridReading = (view) => view.overview.measured?.["grid_on grid"] ?? null;

// Whether a reading says that the grid is lost, and the plan, as by hand, does not say whether it is.
export const isLostByReading = (view) => gridReading(view)?.value === 0 && !view.overview.plan?.grid;

// Whether the grid was read to be lost after the plan was made that counts on it.
export function unawareOfLoss(view) {
  const { plan } = view.overview, read = gridReading(view);
  return read?.value === 0 && plan?.grid?.available === true && !contradiction(view) && new Date(read.at) >= new Date(plan.valid_from ?? plan.start);
}

// Why the plan ignores a reading that the grid is lost; empty if it does not, or if there is a newer one.
function contradiction(view) {
  const { plan } = view.overview;
  const ignores = gridReading(view)?.value === 0 && !plan?.unaware_of?.length;
  return (ignores && plan?.estimated?.find((words) => words.startsWith("grid_on "))) || "";
}

const NOTHING_FORMS = "nothing can form the grid";

// What can form the grid of an island, if it is brought back: named with what is wrong, or brought by a crew.
function couldForm(view) {
  const known = (view.overview.formers ?? []).map((one) => `${one.asset}${one.why_not ? ` (${one.why_not})` : ""}`);
  return `What could form it: ${[...known, "a generator that a crew brings", "the grid when it is back"].join("; ")}.`;
}

// Whether a reading counts: without any the state of the site is not known.
export const isHeard = (view) => view.overview.sources.some((source) => source.ok > 0);

// Whether an island is switched by hand: what is connected may not be supplied.
const isIslandByHand = (view) => Boolean(outage(view) && view.overview.plan && !view.overview.plan.solve && !view.overview.plan.dark);

// Whether supply is uncertain: the plan counts on a grid that is or may be lost, or has ended.
export const isUncertain = (view) => isIslandByHand(view) || unawareOfLoss(view) || contradiction(view) !== "" || view.overview.ahead_s <= 0;

const OF_OUTAGES = ["outage", "outage_belief", "restoration"];
const MOMENT = /\d{4}-\d\d-\d\dT[\d:.]+Z/g;

// What is measured, what is announced and what is ordered, each with its time.
export function facts(view) {
  if (!view.site || !view.overview?.plan) return "";
  const { plan, events } = view.overview, read = gridReading(view);
  const at = (time) => view.clock.at(time, view.now);
  const measured = read ? `grid ${read.value ? "on" : "lost"}, read at ${at(read.at)} (${read.source})` : "the grid is not measured";
  const outages = Object.entries(events).filter(([, event]) => OF_OUTAGES.includes(event.type) && !(event.end && new Date(event.end) <= view.now));
  const told = outages.map(([name, event]) => `${small(announced(event, view))} (${name})`);
  const all = Object.keys(view.site.customers).length, off = (plan.off ?? []).length;
  const why = plan.anew ? ` (${plan.anew.replace(MOMENT, (time) => at(time))})` : "";
  return `Measured: ${measured}. Announced: ${told.length ? list(told) : "no outage"}. Ordered at ${at(plan.valid_from ?? plan.start)}${why}: ${all - off} of ${counted(all, "customer")} connected.`;
}

// The one thing to see first: [level, sentence, more].
export function verdict(view) {
  if (!view.site || !view.overview) {
    return view.lost ? [ALARM, "The service does not answer.", "The state of the site is unknown."] : [NOTE, "Connecting to the service", ""];
  }
  const { plan, mode, ahead_s } = view.overview;
  const at = (time) => view.clock.at(time, view.now);
  const ends = plan?.valid_until ? holds(view, at) : "";
  if (view.lost) return [ALARM, `No contact with the service since ${at(view.heard)}.`, `Data below are from that time. ${ends}`];
  if (!plan) return [WARNING, "No step has been decided yet.", "Devices use default set-points until the first plan."];
  const uncertain = outage(view) || gridReading(view)?.value === 0 ? " There is no grid: supply is uncertain." : "";
  if (ahead_s <= 0) return [ALARM, `The plan ended at ${at(new Date(new Date(plan.start).getTime() + view.site.step_s * 1000))}, and there is no new one.${uncertain}`, ends];
  if (unawareOfLoss(view)) return [ALARM, `Grid lost, read at ${at(gridReading(view).at)}. The plan of ${at(plan.valid_from ?? plan.start)} does not know it: supply is uncertain.`, "A new plan follows."];
  if (contradiction(view)) return [ALARM, "Readings contradict each other on whether there is grid: supply is uncertain.", `The plan ignores a reading: ${contradiction(view)}.`];
  if (plan.dark) {
    const off = `all ${counted(Object.keys(view.site.customers).length, "customer")} are off supply.`, lasts = `${lastingOutage(view, at)}.`;
    return plan.dark === NOTHING_FORMS ? [ALARM, `${capital(plan.dark)}: ${off}`, `${couldForm(view)} ${lasts}`]
      : [ALARM, `The island is blacked out: ${off}`, `${capital(plan.dark)}. ${lasts}`];
  }
  if (plan.status === "failed") return [ALARM, "No plan for this step. It is decided by rule.", plan.reason];
  if (plan.status === "missed") return [WARNING, `This step was missed. ${capital(undecided(plan))}.${uncertain}`, plan.reason];
  const off = offByTier(view), n = Object.values(off).reduce((a, b) => a + b, 0);
  const tiers = view.site.tiers, [first] = tiers, all = Object.keys(view.site.customers).length;
  const dark = outage(view);
  const head = dark ? lastingOutage(view, at) : "";
  if (mode.mode === "off") return [WARNING, `${head ? `${head}. ` : ""}Switched off by the operator: ${undecided(plan)}.${uncertain}`, mode.until ? `Until ${at(mode.until)}. ${mode.reason}` : mode.reason];
  const words = n === 0 ? `all ${counted(all, "customer")} ${isIslandByHand(view) ? "connected" : "supplied"}` : `${n} of ${counted(all, "customer")} off supply`;
  if (off[first] > 0) return [ALARM, `${head ? `${head}: ` : ""}${counted(off[first], tiers.length > 1 ? `${first} customer` : "customer")} off supply.`, `${capital(words)}. ${next(view, at)}`];
  const saved = n > 0 ? `, all ${first} customers supplied` : "";
  if (plan.status === "hold" || plan.status === "manual") {
    return [WARNING, `${head ? `${head}: ${words}` : capital(words)}, ${plan.status === "hold" ? "held" : "set"} by the operator.`, mode.until ? `Until ${at(mode.until)}. ${mode.reason}` : ""];
  }
  if (dark) return [WARNING, `${head}: ${words}${saved}.`, next(view, at)];
  if (n > 0) return [WARNING, `${capital(words)}${saved}.`, next(view, at)];
  if (plan.status === "fallback") return [WARNING, `${capital(words)}, decided by a fallback.`, plan.solve.fallback_reason ?? ""];
  if (!isHeard(view)) return [WARNING, `${counted(all, "customer")} connected by the plan; no reading is in time.`, next(view, at)];
  return [FINE, `${capital(words)}.`, next(view, at)];
}

// The current outage and its end.
function lastingOutage(view, at) {
  const { end, known } = outage(view);
  return `Outage${end ? ` until ${at(end)}${known ? "" : " by the scenario"}` : ", end unknown"}`;
}

// What is announced where no event is: what the scenario itself has of outages.
export function announcesNothing(view) {
  const at = (time) => view.clock.at(time, view.now), now = outage(view), limits = view.overview.plan?.ahead?.grid_limit_kw ?? [];
  if (now) return now.end ? `No event; the scenario has an outage until ${at(now.end)}.` : "No event announces the outage.";
  return limits.includes(0) ? "No event; the scenario has an outage ahead." : "Nothing is announced.";
}

function holds(view, at) {
  const { plan } = view.overview, over = new Date(plan.valid_until);
  return view.now < over ? `Set-points hold until ${at(over)}; then ${undecided(plan)}.` : `Set-points ended at ${at(over)}. ${capital(undecided(plan))}.`;
}

// What devices do without a plan, and what is not known then.
const undecided = (plan) => (plan.grid?.available === false
  ? "devices keep their last state, and how long the island lasts is not known"
  : "devices use default set-points");

const small = (text) => text.charAt(0).toLowerCase() + text.slice(1);
const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

// What comes next: the end of what is stored in an outage, the outage that is announced without.
function next(view, at) {
  if (outage(view)) return foreseen(view, at);
  const faults = outOfService(view, at);
  return faults ? `${faults} ${comes(view, at)}` : comes(view, at);
}

// The order of switching, or what a plan proposes: operations that are left, the state, and what an operator may do next,
// with its request; null for none.
export function switching(view) {
  const found = view.overview.switching;
  const closed = found?.proposed?.closed ?? {};
  if (Object.keys(closed).length && found.status !== "confirm" && found.status !== "waiting") {
    const { order, why } = found.proposed;
    return { operations: order, words: `Proposed: ${why}.`, next: `ask for ${list(states(closed))}`, path: "v1/switching", method: "PUT", body: { closed }, seen: found.etag };
  }
  if (!found || found.status === "none") return null;
  const { status, operations, reason, next } = found;
  const words = {
    confirm: "The first waits for an operator's confirmation.",
    waiting: `An operation is carried out: ${reason}`,
    stopped: `Stopped: ${reason}`,
    done: "All switches are as asked.",
  }[status];
  const verb = next && found.operations[0].startsWith("close ") ? "close" : "open";
  const request = { path: "v1/switching/confirm", method: "POST", body: { switch: next }, seen: found.etag };
  return { operations, words: `Asked for: ${list(states(found.asked))}. ${words}`, next: next ? `${verb} ${next}` : "", ...request };
}

function states(closed) {
  return Object.entries(closed).map(([name, is]) => `${name} ${is ? "closed" : "open"}`);
}

// Lines and buses that are out of service now, or will be; empty for none.
function outOfService(view, at) {
  const faults = (view.overview.plan?.faults ?? []).filter((one) => !one.end || new Date(one.end) > view.now);
  const ends = (one, word) => (one.end ? ` ${word} ${at(one.end)}` : ", end unknown");
  const begun = (one) => one.out && new Date(one.start) <= view.now;
  return faults.map((one) => (begun(one) ? `${capital(one.name)} is out of service${ends(one, "until")}.`
    : `${capital(one.name)} will be out of service from ${at(one.start)}${ends(one, "to")}.`)).join(" ");
}

function comes(view, at) {
  const events = Object.values(view.overview.events).filter((event) => event.type === "outage" && new Date(event.start) > view.now);
  const ahead = view.overview.plan?.ahead;
  const dark = ahead?.grid_limit_kw.indexOf(0) ?? -1;
  // Without an event that says so, a rehearsal's own.
  const said = Object.values(view.overview.events).some((event) => [...OF_OUTAGES, "import_limit"].includes(event.type));
  if (dark >= 0) events.push({ start: ahead.times[dark], end: ahead.times.find((_, t) => t > dark && ahead.grid_limit_kw[t] !== 0), known: said ? "announced" : "known from the scenario," });
  if (!events.length) return possible(view, at) || expected(view, at) || "No outage is announced.";
  const [first] = events.sort((a, b) => new Date(a.start) - new Date(b.start));
  return `Outage ${first.known ?? "announced"} from ${at(first.start)}${first.end ? ` to ${at(first.end)}` : ""}, in ${lasting(new Date(first.start) - view.now)}.`;
}

// The probability of an outage that is not announced as certain.
function possible(view, at) {
  const { outage_probability: likely, start } = view.overview.plan ?? {};
  if (!Array.isArray(likely) || !likely.length) return "";
  const most = Math.max(...likely), t = likely.indexOf(most);
  const time = new Date(new Date(start).getTime() + t * view.site.step_s * 1000);
  return most < 0.005 ? "" : `Outage possible: ${percent(most)} at ${at(time)}.`;
}

// The probability of an outage that the current plan does not include yet.
function expected(view, at) {
  const [first] = Object.values(view.overview.events)
    .filter((event) => event.type === "outage_belief" && event.probability !== 0 && new Date(event.onset?.start) > view.now)
    .sort((a, b) => new Date(a.onset.start) - new Date(b.onset.start));
  return first ? `${belief(first, at)}.` : "";
}

// Planned stored energy.
function foreseen(view, at) {
  const now = storedShare(view.site, (name) => socNow(view, name));
  const low = lowest(view);
  if (now === null) return "";
  return `Stored energy ${percent(now)}${low && low.share < now - 0.005 ? `, planned minimum ${percent(low.share)} at ${at(low.time)}` : ""}.`;
}

// Stored energy as a share of the capacity of batteries with data; null without any.
export function storedShare(site, socOf) {
  let held = 0, all = 0;
  for (const [name, b] of Object.entries(site.batteries)) {
    const soc = socOf(name);
    if (soc === null || soc === undefined) continue;
    held += soc * b.energy_kwh;
    all += b.energy_kwh;
  }
  return all ? held / all : null;
}

// The lowest planned stored energy, and its time.
export function lowest(view) {
  const ahead = view.overview.plan?.ahead;
  const shares = (ahead?.times ?? []).map((_, t) => storedShare(view.site, (name) => ahead.soc[name]?.[t]));
  if (!shares.length || shares.includes(null)) return null;
  const least = Math.min(...shares), t = shares.findIndex((share) => share <= least + 0.01);
  return { share: least, time: new Date(new Date(ahead.times[t]).getTime() + view.site.step_s * 1000) };
}

// The alarms of the service, those to be seen first first: [level, sentence, what is known of it, alarm].
export function alarms(view) {
  return view.overview.alarms.map((alarm) => [alarmLevel(alarm), alarmText(alarm, view), alarmNotes(alarm, view), alarm])
    .sort((a, b) => RANK[a[0]] - RANK[b[0]]);
}

// Whether the condition of an alarm is gone: it is cleared some minutes later.
const isOver = (alarm) => Boolean(alarm.gone_since ?? alarm.cleared_at);

function alarmText(alarm, view) {
  if (!isOver(alarm)) return alarm.text;
  return `Over${alarm.gone_since ? ` since ${view.clock.at(alarm.gone_since, view.now)}` : ""}: ${alarm.text}`;
}

function alarmLevel(alarm) {
  const { state, priority } = alarm;
  if (state !== "raised" || isOver(alarm)) return NOTE;
  return priority === "high" ? ALARM : WARNING;
}

function alarmNotes(alarm, view) {
  const at = (time) => view.clock.at(time, view.now);
  const said = [`raised ${at(alarm.raised_at)}`];
  if (alarm.due && !isOver(alarm)) said.push(`expected at ${at(alarm.due)}`);
  if (alarm.acknowledged_at) said.push(`acknowledged ${at(alarm.acknowledged_at)} by ${alarm.acknowledged_by}`);
  if (alarm.state === "shelved") said.push(`shelved until ${at(alarm.shelved_until)} by ${alarm.shelved_by}`);
  if (alarm.cleared_at) said.push(`cleared ${at(alarm.cleared_at)}`);
  return `${capital(said.join(", "))}.${alarm.state === "raised" && !isOver(alarm) ? ` ${alarm.advice}` : ""}`;
}

// What is worth knowing beside the alarms, the worst first: [level, sentence].
export function attention(view) {
  const { plan, mode, events } = view.overview;
  const at = (time) => view.clock.at(time, view.now);
  const found = [];
  const say = (level, text) => found.push([level, text]);
  if (plan?.unaware_of?.length) say(WARNING, `The plan does not know yet: ${list(plan.unaware_of).replace(MOMENT, (time) => at(time))}.`);
  if (plan?.solve) {
    if (plan.shed?.length) say(WARNING, `Shed, although the plan supplied ${plan.shed.length === 1 ? "it" : "them"}: ${list(plan.shed.map((one) => one.asset))} (${plan.shed[0].reason}).`);
    if (plan.solve.inverted) say(WARNING, `A lower tier is on while a higher one waits: ${plan.solve.inverted}.`);
    if (plan.solve.correction_reason) say(NOTE, `The plan was corrected: ${plan.solve.correction_reason}.`);
    if (plan.solve.outage_messages) say(NOTE, `Several messages speak of one outage: ${plan.solve.outage_messages}.`);
    if (plan.estimated.length) say(NOTE, `Estimated: ${list(plan.estimated)}.`);
    const { v_min_pu: low, v_max_pu: high, import_kw: drawn, grid_limit_kw: limit } = plan.expected;
    if (low !== null && low < view.site.v_min_pu) say(WARNING, `Voltage below its limit: ${low.toFixed(3)} pu${plan.expected.v_min_bus ? ` at bus ${plan.expected.v_min_bus}` : ""}.`);
    if (high !== null && high > view.site.v_max_pu) say(WARNING, `Voltage above its limit: ${high.toFixed(3)} pu.`);
    if (limit > 0 && drawn > 0.98 * limit) say(WARNING, `Import is at its limit: ${kilo(drawn)} of ${kilo(limit)} kW.`);
  }
  if (mode.mode !== "auto") say(WARNING, `Mode ${mode.mode}${mode.until ? ` until ${at(mode.until)}` : ", until further notice"}${mode.reason ? `: ${mode.reason}` : ""}.`);
  for (const event of Object.values(events)) {
    if (event.type === "alert" && covers(event, view.now)) say(WARNING, `${event.source}: ${event.text}`);
  }
  return found.sort((a, b) => RANK[a[0]] - RANK[b[0]]);
}

export function grouped(items, key) {
  const groups = new Map();
  for (const one of items) groups.set(key(one), [...(groups.get(key(one)) ?? []), one]);
  return groups;
}

// The state of charge: read, or estimated where the reading is late; null without any.
export const socNow = (view, name) => view.overview.soc[name] ?? null;

// How long ago a quantity of a device was read, in ms; null if that is not late by its own period.
export function lateBy(view, name, quantity = "soc") {
  const reading = view.overview.measured[`${quantity} ${name}`];
  const late = view.overview.sources.some((source) => [...source.stale, ...source.lost].includes(`${quantity} of ${name}`));
  return late && reading ? view.now - new Date(reading.at) : null;
}

// What is late or was rejected of a source's readings: [class, text].
export function sourceState({ lost, stale, refused, ok }) {
  const said = [];
  if (lost.length) said.push(`\u25a0 ${lost.length} without data: ${list(lost)}`);
  else if (stale.length) said.push(`\u25b2 ${stale.length} late: ${list(stale)}`);
  if (refused.length) said.push(`\u25b2 ${refused.length} rejected: ${list(refused)}`);
  return said.length ? ["late", said.join("; ")] : ["", `\u25cf ${counted(ok, "reading")} in time`];
}

// How old a late reading of a state of charge is, and what is shown in its place.
export const oldSoc = (view, ms, words = "read") => `${words} ${lasting(ms)} ago${view.overview.plan?.expected ? "; estimated" : ""}`;

// A quantity of a device, and what to know of its instrument: {value, old}; the plan's value where no reading counts.
function readOrPlanned(view, quantity, name, planned, instrument, words) {
  const { plan, measured } = view.overview;
  const reading = measured[`${quantity} ${name}`], late = lateBy(view, name, quantity);
  const frozen = plan?.estimated.some((each) => each.startsWith(`${quantity} ${name} `) && each.endsWith("(frozen)"));
  const missing = !reading || reading.value === null;
  const state = frozen ? "stands still" : late !== null ? `read ${lasting(late)} ago` : missing ? "not read" : "";
  return state ? { value: planned ?? null, old: `${instrument} ${state}; ${words}` } : { value: reading.value, old: "" };
}

// The temperature of a room or tank.
export const indoorNow = (view, name) =>
  readOrPlanned(view, "indoor_c", name, view.overview.plan?.expected?.indoor_c?.[name], "thermometer", "reckoned");

// The fuel of a generating set.
export const fuelNow = (view, name) =>
  readOrPlanned(view, "fuel_litres", name, view.overview.plan?.expected?.gensets?.[name]?.fuel_litres, "gauge", "at least this");

// How long so much fuel lasts a set at a power.
export function fuelLasts(set, litres, kw) {
  return `${lasting(litres / (set.litres_per_h_idle + set.litres_per_kwh * kw) * HOUR)} at ${kw.toFixed(1)} kW`;
}

// When a generating set starts or stops next by the plan: {time, starts}; null if it does neither.
export function switchedNext(view, name) {
  const { plan } = view.overview, ahead = plan?.ahead?.genset_kw?.[name] ?? [];
  const on = plan?.gensets[name]?.running === true, t = ahead.findIndex((kw) => kw > 0 !== on);
  return t < 0 ? null : { time: new Date(plan.ahead.times[t]), starts: !on };
}

// Where a room or tank is farthest outside its comfort band, now or by the plan: {by, value, time}; null if it stays inside.
export function farthestOutside(view, name) {
  const { t_min_c: low, t_max_c: high } = view.site.thermal_loads[name], { plan } = view.overview;
  const after = (time) => new Date(new Date(time).getTime() + view.site.step_s * 1000);
  const ahead = (plan?.ahead?.indoor_c?.[name] ?? []).map((value, t) => ({ value, time: after(plan.ahead.times[t]) }));
  const end = plan?.expected?.indoor_end_c?.[name];
  if (Number.isFinite(end)) ahead.unshift({ value: end, time: after(plan.start) });
  const all = [{ value: indoorNow(view, name).value, time: view.now }, ...ahead].filter((one) => one.value !== null)
    .map((one) => ({ ...one, by: Math.max(one.value - high, low - one.value) }));
  const [most] = all.sort((one, other) => other.by - one.by);
  return most && most.by > BAND_C ? most : null;
}

const CANNOT = "cannot be supplied", SHED = "shed", DARK = "blacked out", BY_OPERATOR = ["manual", "hold"];
const REASONS = { plan: "planned", corrected: "planned, then corrected", critical_only: "only the first tier stays supplied" };

// The reason of a customer off supply: the service's explanation if it is there, else the plan's.
// The short form leaves out the figures of a single customer, which follow a semicolon.
export function why(one, explained, status) {
  const dark = one.reason.startsWith(DARK);
  const told = explained?.phase && !dark ? explained.reasons : []; // without a phase it is the plan's words again
  const said = told.find((reason) => reason.kind === "customers" && reason.asset === one.asset);
  const words = said ? capital(said.words.replace(/^Not supplied: /, "")) : planned(one.reason, explained !== null, status);
  return { words, short: said ? words.split("; ")[0].replace(/\.$/, "") : words };
}

function planned(reason, answered, status) {
  const [kind, ...rest] = reason.split(": ");
  if (kind === "default") return rest.length ? `default: ${rest.join(": ")}` : "default";
  if (kind === CANNOT) return reason;
  if (kind === SHED) return `planned as supplied, then disconnected: ${rest.join(": ")}`;
  if (kind === DARK) return rest.join(": ");
  if (BY_OPERATOR.includes(status)) return `by the operator: ${reason}`;
  const words = REASONS[kind] ?? `fallback ${kind.replaceAll("_", " ")}`;
  return kind === "plan" && !answered ? "planned; the reason follows" : words;
}

// An event in a sentence, whatever its kind.
export function announced(event, view) {
  const at = (time) => view.clock.at(time, view.now);
  const span = event.start ? `${covers(event, view.now) && !event.end ? "since" : "from"} ${at(event.start)}${event.end ? ` to ${at(event.end)}` : event.type === "price" ? "" : ", end unknown"}` : "";
  switch (event.type) {
    case "outage": return `Outage ${span}`;
    case "fault": return `${event.line ? `Line ${view.site.lines[event.line]}` : `Bus ${event.bus}`} out of service ${span}`;
    case "import_limit": return `Import at most ${kilo(event.limit_kw)} kW ${span}`;
    case "price": return `Prices ${span}: ${event.price_gbp_per_kwh.slice(0, 3).map((p) => p.toFixed(2)).join(", ")}${event.price_gbp_per_kwh.length > 3 ? ", \u2026" : ""} GBP/kWh`;
    case "alert": return `${event.text} (${span})`;
    case "outage_belief": return belief(event, at);
    case "restoration": return `Restoration ${restored(event, at)}`;
    default: return `${event.type.replaceAll("_", " ")} ${span}`;
  }
}

const SAID_OF_END = { not_before: "not before", likely: "about", by: "by" };

function restored(event, at) {
  return Object.entries(SAID_OF_END).filter(([key]) => event[key]).map(([key, words]) => `${words} ${at(event[key])}`).join(", ");
}

// What a crew says of the end, in one line, as an event; null if it is not understood.
// "not before 16:00, about 18:00", "by 17:30", "within the hour", "back within 30 min".
export function crewSays(text, view) {
  const body = { type: "restoration", source: "operator" };
  for (const part of text.toLowerCase().split(",")) {
    const words = part.trim().replace(/^back /, "");
    const time = /^(not before|about|by) (\d{1,2}:\d{2})$/.exec(words);
    const span = /^within (?:the hour|(\d+(?:\.\d+)?) ?(h|min))$/.exec(words);
    if (time) {
      const key = Object.keys(SAID_OF_END).find((one) => SAID_OF_END[one] === time[1]);
      body[key] = nextAt(time[2], view);
    } else if (span) {
      body.by = new Date(view.now.getTime() + Number(span[1] ?? 1) * (span[2] === "min" ? MINUTE : HOUR)).toISOString();
    } else return null;
  }
  return Object.values(body).includes(null) ? null : body;
}

// The event that records what a crew says, [name, body]: a restoration, or where the service takes
// outages for known the end of the present one.
export function crewEvent(text, view) {
  const said = crewSays(text, view);
  if (said === null) throw new Error("Not understood. Write for example: not before 16:00, about 18:00.");
  if (view.site.believes) return ["crew", said];
  const end = said.by ?? said.likely;
  if (!end) throw new Error("This service plans with a known end. Write: about, by or within.");
  const known = Object.entries(view.overview.events).find(([, event]) => event.type === "outage" && covers(event, view.now));
  if (known) return [known[0], { ...known[1], end }];
  const read = gridReading(view);
  if (read?.value === 0) return ["crew", { type: "outage", source: "operator", start: read.at, end }];
  throw new Error("No outage is announced or measured.");
}

// The next time at which the clocks of the site show these hours and minutes; null if they never do.
function nextAt(clock, view) {
  const begin = Math.ceil(view.now.getTime() / MINUTE);
  for (let minute = begin; minute < begin + 24 * 60; minute++) {
    const time = new Date(minute * MINUTE);
    if (view.clock.hm.format(time) === clock.padStart(5, "0")) return time.toISOString();
  }
  return null;
}

function belief(event, at) {
  const onset = event.onset?.start ? `, from ${at(event.onset.start)}` : "";
  const length = event.duration?.median_h ? `, for about ${event.duration.median_h} h` : "";
  return `Outage possible: ${percent(event.probability ?? 1)}${onset}${length}`;
}

export const MODE_WORDS = {
  auto: ["decide every step", "From now on the controller decides."],
  hold: ["keep the last set-points", "From now on the last set-points are held."],
  manual: ["use the operator\u2019s set-points", "From now on the operator\u2019s set-points are used."],
  off: ["defaults only", "From now on devices use default set-points. With grid: batteries idle, PV at available power, all customers connected, generating sets stopped, chargers and thermostats by themselves. In an outage every device keeps its last state, and nothing is reconnected."],
};
