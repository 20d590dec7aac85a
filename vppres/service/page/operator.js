// The operator's form: mode, duration and reason, with a confirmation.

import { HOUR, MINUTE, MODE_WORDS, crewEvent, onPhase } from "./words.js";

// Of each kind: its heading, and the number that it is given, with label and unit.
const KINDS = {
  customers: ["Customers", "share", "Share (%)", "%"],
  batteries: ["Batteries", "p_kw", "Power (kW)", "kW"],
  pv: ["PV systems", "p_kw", "Power (kW)", "kW"],
  chargers: ["Chargers", "p_limit_kw", "Limit (kW)", "kW"],
  thermal_loads: ["Thermostats", "setpoint_c", "Temperature (°C)", "°C"],
  gensets: ["Generating sets", "p_kw", "Power (kW), 0 to stop", "kW"],
};
const NEED_END = ["hold", "manual"];

const setpointWords = (one) => {
  const [, field, , unit] = KINDS[one.kind];
  if (one.kind !== "customers") return `${one.asset} ${one.kind === "chargers" ? "at most " : ""}${one[field]} ${unit}`;
  return `${one.asset} ${one.served ? "connected" : "disconnected"}${"share" in one ? ` with ${Math.round(100 * one.share)}%` : ""}`;
};

const $ = (id) => document.getElementById(id);

// A change without an answer may have been made all the same.
const failed = (words, error) => (error.unanswered ? "The service gave no answer. The change may have been made: see what is shown." : `${words} ${error.message}`);

export class Operator {
  constructor(ask, look, now, view) {
    this.ask = ask; // sends a request, with the token if there is one
    this.look = look; // shows the state anew
    this.now = now; // the time at the service
    this.view = view; // what the page shows
    this.present = null;
    $("mode-form").addEventListener("submit", (event) => { event.preventDefault(); this.confirm(); });
    $("mode").addEventListener("click", (event) => { event.preventDefault(); this.chosen()?.focus(); $("operator").scrollIntoView(); });
    $("crew-form").addEventListener("submit", (event) => { event.preventDefault(); this.record(); });
    $("confirm").addEventListener("close", () => this.confirmed());
    $("modes").addEventListener("change", () => this.showManual());
    $("manual-device").addEventListener("change", () => this.showManual());
    $("manual-on").addEventListener("change", () => this.showManual());
    $("manual-add").addEventListener("click", () => this.add());
    this.setpoints = new Map(); // by device, not sent yet
  }

  // Something that needs no dialog, on an alarm or an operation.
  async act(path, method, body, answer = "attention-said", headers = {}) {
    const said = await this.ask(path, { method, headers, ...(body && { body: JSON.stringify(body()) }) }).then(() => "", (error) => failed("Nothing was changed.", error));
    await this.look();
    $(answer).textContent = said;
  }

  offer(site) {
    this.dimmable = site.dimmable;
    $("manual-device").replaceChildren(...Object.keys(KINDS).filter((kind) => Object.keys(site[kind]).length).map((kind) => {
      const group = document.createElement("optgroup");
      [group.label] = KINDS[kind];
      group.append(...Object.keys(site[kind]).map((name) => new Option(onPhase(name, site), JSON.stringify([kind, name]))));
      return group;
    }));
    $("modes").replaceChildren(...site.modes.map((mode) => {
      const label = document.createElement("label"), input = document.createElement("input");
      Object.assign(input, { type: "radio", name: "mode", value: mode, required: true });
      label.append(input, `${mode}: ${MODE_WORDS[mode]?.[0] ?? ""}`);
      return label;
    }));
  }

  // What a crew says of the end of the outage.
  async record() {
    const said = $("crew").value;
    try {
      const [name, body] = crewEvent(said, this.view());
      await this.ask(`v1/events/${encodeURIComponent(name)}`, { method: "PUT", body: JSON.stringify(body) });
      $("crew-said").textContent = `Recorded: ${said}${body.type === "outage" ? ", as the end of the outage" : ""}.`;
    } catch (error) {
      $("crew-said").textContent = failed("Not recorded.", error);
    }
  }

  // The current mode; a choice that is not sent yet stays.
  show(mode) {
    if (this.present === mode) return;
    this.present = mode;
    this.choosePresent();
  }

  choosePresent() {
    for (const input of $("modes").querySelectorAll("input")) input.checked = input.value === this.present;
    this.showManual();
  }

  // The set-points of manual mode: one device after another, sent together.
  showManual() {
    $("manual").hidden = this.chosen()?.value !== "manual";
    const [kind, asset] = JSON.parse($("manual-device").value || "[\"batteries\"]");
    $("manual-on-box").hidden = kind !== "customers";
    $("manual-power-box").hidden = !this.takesNumber(kind, asset);
    [, , $("manual-power-label").textContent] = KINDS[kind];
    $("manual-list").replaceChildren(...[...this.setpoints].map(([key, one]) => {
      const item = document.createElement("li"), remove = document.createElement("button");
      Object.assign(remove, { type: "button", className: "quiet", textContent: "Remove", ariaLabel: `Remove ${one.asset}` });
      remove.addEventListener("click", () => { this.setpoints.delete(key); this.showManual(); $("manual-add").focus(); });
      item.append(setpointWords(one), " ", remove);
      return item;
    }));
  }

  // Customers have a share only if they can be dimmed, and are connected.
  takesNumber(kind, asset) { return kind !== "customers" || (asset in this.dimmable && $("manual-on").value === "on"); }

  add() {
    const key = $("manual-device").value, [kind, asset] = JSON.parse(key);
    const given = $("manual-power"), one = { kind, asset };
    if (kind === "customers") one.served = $("manual-on").value === "on";
    if (this.takesNumber(kind, asset)) {
      if (given.value === "" || !given.checkValidity()) { given.focus(); return; }
      const [, field, , unit] = KINDS[kind];
      one[field] = unit === "%" ? Number(given.value) / 100 : Number(given.value);
    }
    this.setpoints.set(key, one);
    this.showManual();
  }

  chosen() { return $("modes").querySelector(":checked"); }

  async confirm() {
    const mode = this.chosen()?.value;
    if (!mode) return;
    await this.looked; // what is replaced is what is shown
    if (mode === "manual" && !this.setpoints.size) { $("mode-said").textContent = "Add a set-point first."; $("manual-device").focus(); return; }
    const hours = $("mode-hours");
    if (NEED_END.includes(mode) && !hours.value) hours.value = "1";
    const span = hours.value ? `For ${hours.selectedOptions[0].text}, then auto.` : "Until further notice.";
    $("confirm-title").textContent = `Change the mode to ${mode}?`;
    let asked = "";
    if (mode === "manual") {
      asked = ` ${[...this.setpoints.values()].map(setpointWords).join("; ")}.`;
      try {
        const { found } = await this.ask("v1/mode/check", { method: "POST", body: JSON.stringify(this.body(mode)) });
        asked += found.map((words) => ` ${words}`).join("");
      } catch (error) {
        $("mode-said").textContent = `The mode was not changed. ${error.message}`;
        this.choosePresent();
        return;
      }
    }
    this.seen = this.view().overview.mode.etag;
    $("confirm-words").textContent = `${MODE_WORDS[mode]?.[1] ?? ""}${asked} ${span}`;
    $("confirm-no").textContent = `No, keep ${this.present}`;
    $("confirm-yes").textContent = `Yes, change to ${mode}`;
    $("confirm").returnValue = "";
    $("confirm").showModal();
  }

  // A mode ends at a whole minute, as shown: the clock advances while the dialog is open.
  after(hours) {
    return new Date(Math.round((this.now().getTime() + hours * HOUR) / MINUTE) * MINUTE);
  }

  body(mode) {
    const hours = Number($("mode-hours").value);
    const until = hours ? this.after(hours).toISOString() : null;
    const setpoints = mode === "manual" ? [...this.setpoints.values()] : [];
    return { mode, until, reason: $("mode-reason").value, setpoints };
  }

  async confirmed() {
    $("mode-change").focus();
    if ($("confirm").returnValue !== "yes") {
      this.choosePresent();
      return;
    }
    const body = this.body(this.chosen().value);
    $("mode-change").disabled = true;
    $("mode-said").textContent = "Waiting for the service.";
    const said = await this.ask("v1/mode", { method: "PUT", headers: { "If-Match": this.seen }, body: JSON.stringify(body) })
      .then((answer) => { this.present = answer.mode; this.setpoints.clear(); return `The mode is ${answer.mode}.`; }, (error) => failed("The mode was not changed.", error));
    this.looked = this.look();
    this.choosePresent();
    $("mode-change").disabled = false;
    $("mode-change").focus();
    $("mode-said").textContent = said;
  }
}
