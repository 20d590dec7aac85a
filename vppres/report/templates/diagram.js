// The step selector of the one-line diagram. The page is complete without it: it then shows the
// step that it was written with.
(function () {
  "use strict";
  const source = document.getElementById("diagram-data");
  if (!source) { return; }
  const data = JSON.parse(source.textContent);
  const slider = document.getElementById("step-slider");
  const svg = document.getElementById("one-line");
  const words = document.getElementById("step-words");
  const all = (name) => [...svg.querySelectorAll("[data-" + name + "]")];
  const circles = all("voltage"), tiles = all("bus"), lines = all("line"), levels = all("battery");

  function setClass(element, prefix, digit) {
    const kept = [...element.classList].filter((name) => !/^[a-z]\d$/.test(name));
    element.setAttribute("class", [...kept, prefix + digit].join(" "));
  }

  function lineWords(line, step) {
    const amps = data.amps[step][line], rating = data.ratings[line];
    return data.lines[line] + ": " + amps + " A"
      + (rating === null ? "" : ", " + Math.round(100 * amps / rating) + "% of " + rating + " A");
  }

  function busWords(circle, step) {
    const bus = Number(circle.dataset.voltage), v = data.v[step][bus];
    const parts = [circle.dataset.name + ": " + (v === null ? "no voltage"
                                                 : (v / 10000).toFixed(4) + " pu")];
    for (const c of JSON.parse(circle.dataset.customers)) {
      parts.push(data.customers[c] + (data.served[step][c] === "1" ? " supplied" : " off supply"));
    }
    for (const b of JSON.parse(circle.dataset.batteries)) {
      parts.push("battery " + data.batteries[b] + " at " + data.soc[step][b] + "%");
    }
    return parts.join("\n");
  }

  function show(step) {
    slider.value = step;
    svg.dataset.step = step;
    svg.classList.toggle("dead-grid", data.outage[step] === 1);
    words.querySelector("strong").textContent = data.time[step];
    words.lastChild.textContent = ": " + data.info[step];
    circles.forEach((circle) => {
      setClass(circle, "v", data.bus[step][Number(circle.dataset.voltage)]);
      circle.firstElementChild.textContent = busWords(circle, step);
    });
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
    document.dispatchEvent(new CustomEvent("vppres-step", { detail: step }));
  }

  const last = data.time.length - 1;
  const move = (by) => show(Math.min(last, Math.max(0, Number(slider.value) + by)));
  slider.addEventListener("input", () => show(Number(slider.value)));
  document.getElementById("step-back").addEventListener("click", () => move(-1));
  document.getElementById("step-forward").addEventListener("click", () => move(1));
  document.getElementById("step-worst").addEventListener("click", () => show(data.start));
  document.addEventListener("vppres-show", (event) => show(event.detail));

  let before = data.start;  // paper has no slider: it shows the worst step
  window.addEventListener("beforeprint", () => {
    before = Number(slider.value);
    show(data.start);
  });
  window.addEventListener("afterprint", () => show(before));
  show(data.start);
})();
