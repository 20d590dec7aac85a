// The report of a run: its charts and its diagram show one step, which is chosen in any of them.
(function () {
  "use strict";
  const data = JSON.parse(document.getElementById("diagram-data").textContent);
  const slider = document.getElementById("step-slider"), svg = document.getElementById("one-line");
  const words = document.getElementById("step-words"), pointed = document.getElementById("bus-words");
  const all = (name) => [...svg.querySelectorAll("[data-" + name + "]")];
  const parts = all("part"), circles = all("voltage"), tiles = all("bus"), lines = all("line"), levels = all("battery");
  const last = data.time.length - 1;

  function setClass(element, prefix, digit) {
    const kept = [...element.classList].filter((name) => !/^[a-z]\d$/.test(name));
    element.setAttribute("class", [...kept, prefix + digit].join(" "));
  }

  function lineWords(line, step) {
    const state = { 8: "open", 9: "out of service" }[data.line[step][line]];
    if (state) { return data.lines[line] + ": " + state; }
    const amps = data.amps[step][line], rating = data.ratings[line];
    return data.lines[line] + ": " + amps + " A"
      + (rating === null ? "" : ", " + Math.round(100 * amps / rating) + "% of " + rating + " A");
  }

  const customerWords = (c, step) => data.customers[c]
    + (data.served[step][c] === "1" ? " supplied, " : " off supply, ") + data.kw[step][c] + " kW";

  function voltageWords(bus, step) {
    const v = data.v[step][bus];
    return "Bus " + data.buses[bus].name + ": " + (v === null ? "no voltage" : (v / 10000).toFixed(4) + " pu");
  }

  function busWords(bus, step) {
    const { connected } = data.buses[bus];
    const part = [[], ["without the grid"], ["without the grid"], ["forms the grid of its part"], ["without the grid"]];
    return [voltageWords(bus, step), ...part[data.part[step][bus]],
      ...connected.customers.map((c) => customerWords(c, step)),
      ...connected.batteries.map((b) => "battery " + data.batteries[b] + " at " + data.soc[step][b] + "%"),
      ...Object.entries(data.devices).flatMap(([kind, names]) => connected[kind].map((i) => names[i]))];
  }

  // What is in a row of a chart; of customers without a row that is pointed at, who is off.
  function rowWords(kind, row, step) {
    if (kind === "customers" && row === null) {
      const off = [...data.served[step]].flatMap((digit, c) => digit === "1" ? [] : [data.customers[c]]);
      return [off.length ? "off supply: " + off.slice(0, 12).join(", ") + (off.length > 12 ? " and " + (off.length - 12) + " more" : "") : "all supplied"];
    }
    const said = { customers: customerWords, buses: voltageWords, lines: lineWords }[kind];
    return row === null ? [] : row.map((i) => said(i, step));
  }

  const charts = new Pictures.Charts(data.time, Pictures.spansOf(data.outage), rowWords);
  const feeder = new Pictures.Feeder(svg);
  document.querySelectorAll("figure.plot:has(script)").forEach((figure) =>
    charts.add(figure, JSON.parse(figure.querySelector("script").textContent)));

  function draw(step) {
    slider.value = step;
    svg.dataset.step = step;
    svg.classList.toggle("dead-grid", data.outage[step] === 1);
    words.querySelector("strong").textContent = data.time[step];
    words.lastChild.textContent = ": " + data.info[step];
    circles.forEach((circle) => {
      setClass(circle, "v", data.bus[step][Number(circle.dataset.voltage)]);
      circle.firstElementChild.textContent = busWords(Number(circle.dataset.voltage), step).join("\n");
    });
    parts.forEach((part) => setClass(part, "p", data.part[step][Number(part.dataset.part)]));
    tiles.forEach((tile) => setClass(tile, "s", data.tile[step][Number(tile.dataset.bus)]));
    lines.forEach((line) => {
      setClass(line, "l", data.line[step][Number(line.dataset.line)]);
      line.firstElementChild.textContent = lineWords(Number(line.dataset.line), step);
    });
    levels.forEach((level) => {
      const height = 0.14 * data.soc[step][Number(level.dataset.battery)];
      level.setAttribute("height", height);
      level.setAttribute("y", Number(level.dataset.base) - height);
    });
  }
  charts.onChoose = draw;

  const move = (by) => charts.choose(Math.min(last, Math.max(0, charts.chosen + by)));
  const clicked = (id, action) => document.getElementById(id).addEventListener("click", action);
  slider.addEventListener("input", () => charts.choose(Number(slider.value)));
  clicked("step-back", () => move(-1));
  clicked("step-forward", () => move(1));
  clicked("step-worst", () => charts.choose(data.start));
  clicked("closer", () => feeder.zoom(1.5));
  clicked("farther", () => feeder.zoom(1 / 1.5));
  clicked("whole", () => feeder.fit());
  svg.addEventListener("pointerover", (event) => {
    const bus = event.target.closest(".bus"), line = event.target.closest(".line");
    if (bus) { pointed.textContent = busWords(bus.dataset.number, charts.chosen).join("; "); }
    if (line) { pointed.textContent = lineWords(Number(line.dataset.line), charts.chosen); }
  });

  // Paper is of one width and has no slider: it shows everything, and the worst step.
  let before = null;
  window.addEventListener("beforeprint", () => {
    before = [charts.chosen, charts.from, charts.to];
    charts.charts.forEach(({ axis }) => axis.layout(Pictures.PAPER, 0, 1));
    feeder.asDrawn();
    charts.choose(data.start);
  });
  window.addEventListener("afterprint", () => {
    [, charts.from, charts.to] = before;
    charts.choose(before[0]);
    fit();
  });

  function fit() {
    charts.fit();
    feeder.fit();
  }
  let width = window.innerWidth;
  window.addEventListener("resize", () => {
    if (width !== window.innerWidth) { width = window.innerWidth; fit(); }
  });
  charts.chosen = data.start;
  fit();
  draw(data.start);
  document.documentElement.dataset.charts = "drawn";
})();
