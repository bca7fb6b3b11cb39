/* Chart of one series over the nights: values with uncertainty, fit with band, steps, control limits, tolerance. */
import { band, chart, fall, level, line, points, reach } from "./chart.js";
import { make } from "./dom.js";
import { number, say } from "./language.js";
import { told } from "./sentences.js";

const COVERAGE = 2, SHORTEST_NIGHTS = 1;

/* A rate per night from less than one night is meaningless. */
const longEnough = ({ nights }) => nights.at(-1) - nights[0] >= SHORTEST_NIGHTS;

export function trendFigure(trend, title) {
  const { nights, values, unit, fitted, fitted_half_width: half, control_limits: limits, tolerance, steps } = trend;
  const doubts = trend.standard_uncertainties?.map((sigma) => COVERAGE * sigma) ?? null;
  const all = [...values.flatMap((value, i) => [value - (doubts?.[i] ?? 0), value + (doubts?.[i] ?? 0)]), ...(tolerance === null ? [] : [tolerance, ...(trend.two_sided ? [-tolerance] : [])]), ...(limits ? [limits[0], limits[2]] : [])];
  const x = reach(nights, { margin: 0.06 }), y = reach(all, { zero: !trend.two_sided });
  if (!trend.two_sided) y[0] = Math.max(y[0], 0);
  const draws = [
    ...(fitted && half && longEnough(trend) ? levelByLevel(trend) : []),
    ...(limits ? [limits[0], limits[2]].map((limit) => level(limit, [Math.max(lastStep(trend), x[0]), x[1]], "control")) : []),
    ...(tolerance === null ? [] : [level(tolerance, x, "tolerance"), ...(trend.two_sided ? [level(-tolerance, x, "tolerance")] : [])]),
    ...steps.map(({ night }) => fall(night, y, "step")),
    points(nights, values, doubts, "value"),
  ];
  return make("figure", { className: "trend" }, chart({ title, xLabel: say("trend.nights"), yLabel: unit, x, y, draws, height: 190 }),
    make("figcaption", {}, drifting(trend)));
}

const lastStep = ({ steps }) => Math.max(-Infinity, ...steps.map(({ night }) => night));

/* The fit is drawn section by section, so that a step is no slanted line; the band belongs to the section since the last step. */
function levelByLevel({ nights, fitted, fitted_half_width: half, steps }) {
  const edges = [-Infinity, ...steps.map(({ night }) => night), Infinity];
  const pieces = edges.slice(1).map((end, i) => nights.map((_, at) => at).filter((at) => nights[at] >= edges[i] && nights[at] < end)).filter((piece) => piece.length);
  const last = pieces.at(-1), of = (values, piece) => piece.map((at) => values[at]);
  const low = of(fitted, last).map((value, i) => value - half[last[i]]), high = of(fitted, last).map((value, i) => value + half[last[i]]);
  return [band(of(nights, last), low, high, "fit"), ...pieces.map((piece) => line(of(nights, piece), of(fitted, piece), "fit"))];
}

export function drifting(trend) {
  const { values, unit, drift_a_night: drift, drift_standard_uncertainty: sigma, significant, nights_left } = trend;
  const now = say("trend.now", { value: number(values.at(-1), 2), unit });
  if (drift === null || !longEnough(trend)) return `${now} · ${say("trend.too_few")}`;
  const rate = say("trend.drift", { drift: number(drift, 3), doubt: number(COVERAGE * sigma, 3), unit });
  const left = nights_left === null ? "" : ` · ${say("trend.left", { nights: number(nights_left, 0) })}`;
  return `${now} · ${rate}${significant ? ` · ${say("trend.significant")}` : ""}${left}`;
}

/* Drift per night, with its uncertainty and unit. */
export function rateOf(trend) {
  const { drift_a_night: drift, drift_standard_uncertainty: sigma } = trend;
  return drift === null || !longEnough(trend) ? "–" : say("parameters.rate", { drift: number(drift, 3), doubt: number(COVERAGE * sigma, 3) });
}

export function keyOfLines() {
  const kinds = ["value", "fit", "control", "tolerance", "step"];
  return make("p", { className: "remark lines" }, ...kinds.map((kind) => make("span", { className: kind }, say(`trend.line_${kind}`))));
}

export function alarmList(alarms) {
  return alarms.length ? [make("ul", { className: "trend-alarms" }, ...alarms.map(({ kind, text }) => make("li", {}, make("b", {}, say(`trend.alarm_${kind}`)), " ", told(text))))] : [];
}
