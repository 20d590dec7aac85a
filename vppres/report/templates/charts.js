// Draws the charts that wait in the page, and ties them to each other and to the diagram. Only then
// are the static figures hidden that they replace.
(function () {
  "use strict";
  const charts = [...document.querySelectorAll(".plot")];
  const config = { displaylogo: false, responsive: true,
                   modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };
  document.documentElement.classList.add("scripted");

  let following = false;  // a zoom that was copied is not copied back
  function follow(chart, change) {
    const range = { "xaxis.range[0]": change["xaxis.range[0]"],
                    "xaxis.range[1]": change["xaxis.range[1]"] };
    const auto = change["xaxis.autorange"];
    if (following || (range["xaxis.range[0]"] === undefined && !auto)) { return; }
    following = true;
    const home = (other) => ({ "xaxis.range": other.home.slice() });
    Promise.all(charts.filter((other) => auto || other !== chart)
      .map((other) => Plotly.relayout(other, auto ? home(other) : range)))
      .finally(() => { following = false; });
  }

  function stepOf(chart, point) {
    const last = chart.data[0].x.length - 2;  // the last time is the end of the day
    return Math.min(last, point.pointIndex === undefined ? point.pointNumber : point.pointIndex);
  }

  Promise.all(charts.map((chart) => {
    const figure = JSON.parse(document.getElementById(chart.id + "-data").textContent);
    chart.home = figure.layout.xaxis.range.slice();
    return Plotly.newPlot(chart, figure.data, figure.layout, config).then(() => {
      chart.on("plotly_relayout", (change) => follow(chart, change));
      chart.on("plotly_click", (event) => document.dispatchEvent(
        new CustomEvent("vppres-show", { detail: stepOf(chart, event.points[0]) })));
    });
  })).then(() => {
    function mark(step) {
      charts.forEach((chart) => {
        const time = chart.data[0].x[step];
        Plotly.relayout(chart, { "shapes[0].x0": time, "shapes[0].x1": time });
      });
    }
    document.addEventListener("vppres-step", (event) => mark(event.detail));
    mark(Number(document.getElementById("step-slider").value));
    document.documentElement.dataset.charts = "drawn";
  });
})();
