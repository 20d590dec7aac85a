// Values under the pointer in every chart, and a line at the step that the diagram shows; a click
// moves the diagram. The page is complete without it.
(function () {
  "use strict";
  const SVG = "http://www.w3.org/2000/svg";
  const source = document.getElementById("diagram-data");
  const slider = document.getElementById("step-slider");
  const times = JSON.parse(source.textContent).time;

  function withCursor(figure) {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const svg = figure.querySelector("svg");
    const cursor = document.createElementNS(SVG, "line");
    cursor.setAttribute("class", "cursor");
    cursor.setAttribute("y1", data.top);
    cursor.setAttribute("y2", data.bottom);
    svg.append(cursor);
    return { data, svg, cursor, words: figure.querySelector(".readings") };
  }
  const charts = [...document.querySelectorAll("figure.plot:has(script)")].map(withCursor);

  function stepAt(chart, event) {
    const place = new DOMPoint(event.clientX, event.clientY)
      .matrixTransform(chart.svg.getScreenCTM().inverse());
    const share = (place.x - chart.data.left) / (chart.data.right - chart.data.left);
    const step = Math.floor(share * chart.data.steps);
    return step >= 0 && step < chart.data.steps ? step : null;
  }

  function reading(curve, step) {
    const sample = document.createElement("span");
    const color = document.createElement("i");
    color.style.background = curve.color;
    sample.append(color, curve.name + " " + curve.values[step]);
    return sample;
  }

  function show(chart, step) {
    const { left, right, steps, curves } = chart.data;
    const x = left + (right - left) * step / steps;
    chart.cursor.setAttribute("x1", x);
    chart.cursor.setAttribute("x2", x);
    const time = document.createElement("strong");
    time.textContent = times[step];
    const known = curves.filter((curve) => curve.values[step] !== "");
    chart.words.replaceChildren(time, ...known.map((curve) => reading(curve, step)));
  }

  const showAll = (step) => charts.forEach((chart) => show(chart, step));
  charts.forEach((chart) => {
    chart.svg.addEventListener("pointermove", (event) => {
      const step = stepAt(chart, event);
      if (step !== null) { showAll(step); }
    });
    chart.svg.addEventListener("pointerleave", () => showAll(Number(slider.value)));
    chart.svg.addEventListener("click", (event) => {
      const step = stepAt(chart, event);
      if (step !== null) {
        document.dispatchEvent(new CustomEvent("vppres-show", { detail: step }));
      }
    });
  });
  document.addEventListener("vppres-step", (event) => showAll(event.detail));
  showAll(Number(slider.value));
  document.documentElement.dataset.charts = "drawn";
})();
