// Accuracy against time.
"use strict";

// Whose point is the large one, as a phone has no room for every name.
function pointed() {
  const own = rowsDrawn("accuracy").values.find((row) => Number(row.id) === state.c);
  return own ? `The largest marker is the selected configuration, ${marked(state.c)}.` : `${marked(state.c)} is not in this figure.`;
}

// The axis names the chosen percentile, which Vega-Lite cannot do.
FIGURES.accuracy = {
  sized: (spec, width) => {
    const made = fitted(spec, width), called = (axis) => (axis.title?.startsWith?.("p50")
      ? { ...axis, title: { signal: `percentile + ${JSON.stringify(axis.title.slice(3))}` } } : axis);
    return { ...made, axes: made.axes.map(called) };
  },
};

const drawPercentile = () => signal("accuracy", { percentile: $("percentile").value });

SECTIONS.push({
  id: "accuracy", after: ["c", "p"],
  draw: async () => {
    await mark("accuracy", { id: String(state.c) });
    $("accuracy-chosen").replaceChildren(...coded(pointed()));
  },
  redraw: drawPercentile,
  listen: () => on("percentile", "change", drawPercentile),
});
