/* Section with the drift of the geometric errors: largest value of each along its axis, and the parameters of the chosen one. */
import { make } from "./dom.js";
import { day, known, number, say } from "./language.js";
import { heading, remark, table } from "./parts.js";
import { read } from "./requests.js";
import { dateOf, keyOfLines, rateOf, spans, trendFigure } from "./trend-figure.js";

export const ofRun = false;
const STEPS_SHOWN = 2;
let chosen = null;

export async function parts({ again }) {
  const { trends, marks } = await read("/api/page/trends");
  const errors = trends.filter(({ volumetric }) => !volumetric);
  if (!errors.length) return [heading("parameters.title"), remark("trend.none")];
  if (!errors.some(({ name }) => name === chosen)) chosen = errors[0].name;
  const choose = (name) => {
    chosen = name;
    again({ quiet: true });
  };
  const zoomed = () => again({ quiet: true });
  const single = (await read(`/api/page/trends?of=${encodeURIComponent(chosen)}`)).trends;
  const own = errors.find(({ name }) => name === chosen);
  return [heading("parameters.title"), remark("parameters.choose"),
    make("div", { className: "split" }, table(["parameters.error", "parameters.now", "parameters.drift", "parameters.steps"].map((key) => say(key)), errors.map((trend) => row(trend, choose)), "compact"),
      make("div", {}, make("h3", {}, say("parameters.of", { name: chosen })), spans(zoomed), keyOfLines(marks), trendFigure(own, chosen, marks, zoomed), ...single.map((trend) => trendFigure(trend, titleOf(trend.name), marks, zoomed))))];
}

function row(trend, choose) {
  const { name, values, unit, significant, steps } = trend;
  return [
    make("button", { ariaPressed: String(name === chosen), onclick: () => choose(name) }, name),
    say("unit.value", { value: number(values.at(-1), 2), unit }),
    make("span", { className: significant ? "strong" : "" }, rateOf(trend)),
    latestOf(steps, trend),
  ];
}

/* The latest steps, each in a line of its own, and how many there were before them. */
function latestOf(steps, trend) {
  const shown = steps.slice(-STEPS_SHOWN).reverse(), earlier = steps.length - shown.length;
  return make("div", { className: "latest-steps" }, ...shown.map(({ night, size }) =>
    make("span", {}, say("parameters.step", { date: day(dateOf(trend, night)), size: number(size, 1) }))),
  earlier ? make("small", {}, say("parameters.earlier", { count: number(earlier, 0) })) : null);
}

function titleOf(name) {
  const [, error, order] = /^(\w+)\[(\w+)\]$/.exec(name) ?? [null, name, ""];
  return known(`parameters.order_${order}`) ? `${error} ${say(`parameters.order_${order}`)}` : say("parameters.order", { error, order });
}
