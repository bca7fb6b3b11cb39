/* Chart of one series over the nights: values with uncertainty, fit with band, steps, control limits, tolerance, what is
   expected of the next nights with the dates at which the tolerance is reached, and marks of the runs that changed the compensation or found the machine changed. A span of time is chosen by a button or
   by dragging over a chart. */
import { band, chart, fall, level, line, MANY, pathOf, points, reach } from "./chart.js";
import { draw, make } from "./dom.js";
import { day, dayOfDate, minute, number, say } from "./language.js";
import { choice } from "./parts.js";
import { told } from "./sentences.js";

const COVERAGE = 2, SHORTEST_NIGHTS = 1, MS_PER_DAY = 86_400_000, DRAGGED_PX = 12, FEW_NIGHTS = 3, BEYOND = 1.1;
const SPANS = ["all", "365", "90", "30"];
const view = { span: "all", range: null };

/* A rate per night from less than one night is meaningless. */
const longEnough = ({ nights }) => nights.at(-1) - nights[0] >= SHORTEST_NIGHTS;

/* `marks`: runs to be marked; `zoomed` is called after another span was chosen by dragging. */
export function trendFigure(trend, title, marks = [], zoomed = () => {}) {
  const shown = windowed(trend), { nights, values, unit, fitted, fitted_half_width: half, control_limits: limits, tolerance, steps } = shown;
  if (!nights.length) return make("figure", { className: "trend" }, make("figcaption", {}, title, ": ", say("trend.nothing")));
  const doubts = shown.standard_uncertainties?.map((sigma) => COVERAGE * sigma) ?? null;
  const all = [...values.flatMap((value, i) => [value - (doubts?.[i] ?? 0), value + (doubts?.[i] ?? 0)]), ...(tolerance === null ? [] : [tolerance, ...(trend.two_sided ? [-tolerance] : [])]), ...(limits ? [limits[0], limits[2]] : [])];
  const ahead = aheadOf(trend), x = view.range ?? reach([...nights, ...(ahead?.nights ?? [])], { margin: 0.06 }), y = reach(all, { zero: !trend.two_sided });
  if (!trend.two_sided) y[0] = Math.max(y[0], 0);
  const inside = ({ night }) => night >= x[0] && night <= x[1];
  const name = x[1] - x[0] < FEW_NIGHTS ? minute : day;
  const draws = [
    points(nights, values, doubts, "value"),
    ...(fitted && half && hasSlope(trend) ? levelByLevel(shown) : []),
    ...(limits ? [limits[0], limits[2]].map((limit) => level(limit, [Math.min(Math.max(lastStep(trend), x[0]), x[1]), x[1]], "control")) : []),
    ...(tolerance === null ? [] : [level(tolerance, x, "tolerance"), ...(trend.two_sided ? [level(-tolerance, x, "tolerance")] : [])]),
    ...(ahead ? forecastDraws(trend, ahead, x, y) : []),
    ...steps.filter(inside).map(({ night }) => fall(night, y, "step")),
    ...marks.filter(inside).map((mark, _, those) => tick(mark, y, those.length > MANY)),
  ];
  const svg = chart({ title, xLabel: "", yLabel: unit, x, y, draws, height: 190, ticksX: 4, nameX: (night) => name(dateOf(trend, night)) });
  listen(svg, x, zoomed);
  const help = trend.action ? [make("figcaption", { className: "help" }, told(trend.action.text))] : [];
  return make("figure", { className: "trend" }, svg, make("figcaption", {}, drifting(trend)), ...help);
}

/* The next nights until a little after the last date that is marked; null if no date is expected. */
function aheadOf({ nights, forecast }) {
  const [, expected, latest] = forecast?.nights_to ?? [];
  if (expected === null || expected === undefined) return null;
  const { course } = forecast, end = Math.min(forecast.horizon_nights, BEYOND * (latest ?? forecast.horizon_nights));
  const those = course.nights.map((_, i) => i).filter((i) => course.nights[i] <= end), of = (list) => those.map((i) => list[i]);
  return { nights: of(course.nights).map((night) => nights.at(-1) + night), low: of(course.low), middle: of(course.middle), high: of(course.high) };
}

/* Expected value with its band from 5 % to 95 %, and on the tolerance the dates with 5 %, 50 % and 95 %. */
function forecastDraws({ nights: measured, forecast, tolerance, two_sided }, { nights, low, middle, high }, x, y) {
  const those = nights.map((_, i) => i).filter((i) => nights[i] >= x[0] && nights[i] <= x[1]), of = (list) => those.map((i) => Math.min(Math.max(list[i], y[0]), y[1]));
  if (!those.length) return [];
  const last = measured.at(-1), side = two_sided && middle.at(-1) < 0 ? -tolerance : tolerance, shown = those.map((i) => nights[i]);
  const seen = those.filter((i) => middle[i] >= y[0] && middle[i] <= y[1]);
  const marks = forecast.nights_to.map((ahead, i) => ({ at: last + ahead, date: forecast.dates[i], half: i === 1 ? 9 : 5, known: ahead !== null })).filter(({ at, known }) => known && at >= x[0] && at <= x[1]);
  return [band(shown, of(low), of(high), "forecast"), line(seen.map((i) => nights[i]), seen.map((i) => middle[i]), "forecast"),
    ...marks.map(({ at, date, half }) => (scales) => [draw("line", { x1: scales.x(at), x2: scales.x(at), y1: scales.y(side) - half, y2: scales.y(side) + half, class: "due" }, draw("title", {}, dayOfDate(date)))])];
}

/* Rates of many nights are small: as many decimals as their uncertainty needs. */
const rateDigits = (doubt) => Math.min(Math.max(Math.ceil(1 - Math.log10(doubt || 1)), 3), 6);

/* The slope of the fit is stated and drawn only if it can be told from zero. */
const hasSlope = (trend) => trend.significant && longEnough(trend);

const lastStep = ({ steps }) => Math.max(-Infinity, ...steps.map(({ night }) => night));

/* The runs of the chosen span. */
function windowed(trend) {
  const { nights } = trend, last = nights.at(-1);
  const [from, to] = view.range ?? (view.span === "all" ? [-Infinity, Infinity] : [last - Number(view.span), Infinity]);
  const inside = nights.map((_, i) => i).filter((i) => nights[i] >= from && nights[i] <= to);
  const of = (list) => (list ? inside.map((i) => list[i]) : list);
  return { ...trend, nights: of(nights), values: of(trend.values), standard_uncertainties: of(trend.standard_uncertainties), fitted: of(trend.fitted), fitted_half_width: of(trend.fitted_half_width) };
}

/* Date of a night: between two runs by interpolation, and by the calendar outside them. */
export function dateOf({ nights, started }, night) {
  const after = nights.findIndex((one) => one > night), at = (i) => Date.parse(started[i]);
  if (after === 0) return at(0) + (night - nights[0]) * MS_PER_DAY;
  if (after < 0) return at(nights.length - 1) + (night - nights.at(-1)) * MS_PER_DAY;
  return at(after - 1) + ((night - nights[after - 1]) / (nights[after] - nights[after - 1])) * (at(after) - at(after - 1));
}

/* Triangle on the axis, with its meaning and date as its title; narrow if there are many. */
const tick = ({ night, kind, started }, [low], dense) => ({ x, y }) => {
  const [at, foot] = [x(night), y(low)], half = dense ? 1 : 5;
  return [draw("path", { d: `${pathOf([[at - half, foot + 8], [at + half, foot + 8], [at, foot]])}Z`, class: `event ${kind}${dense ? " dense" : ""}` },
    draw("title", {}, `${say(`trend.mark_${kind}`)}, ${day(Date.parse(started))}`))];
};

/* A drag over the chart chooses a span; a double click shows everything again. */
function listen(svg, [low, high], zoomed) {
  let from = null;
  const nightAt = ({ clientX }) => {
    const box = svg.getBoundingClientRect(), [left, right] = [svg.dataset.left, svg.dataset.right].map((edge) => (Number(edge) * box.width) / svg.viewBox.baseVal.width);
    return low + (Math.min(Math.max((clientX - box.left - left) / (right - left), 0), 1)) * (high - low);
  };
  svg.addEventListener("pointerdown", (event) => (from = event));
  svg.addEventListener("pointerup", (event) => {
    if (from && Math.abs(event.clientX - from.clientX) > DRAGGED_PX) {
      view.range = [nightAt(from), nightAt(event)].sort((a, b) => a - b);
      zoomed();
    }
    from = null;
  });
  svg.addEventListener("dblclick", () => {
    Object.assign(view, { span: "all", range: null });
    zoomed();
  });
}

/* Buttons for the span of time; `zoomed` is called after another one was chosen. */
export function spans(zoomed) {
  const chosen = (span) => {
    Object.assign(view, { span, range: null });
    zoomed();
  };
  return choice("trend.span", SPANS.map((span) => [span, `trend.span_${span}`]), view.range ? null : view.span, chosen);
}

/* The fit is drawn section by section, so that a step is no slanted line; the band belongs to the section since the last step. */
function levelByLevel({ nights, fitted, fitted_half_width: half, steps }) {
  const edges = [-Infinity, ...steps.map(({ night }) => night), Infinity];
  const pieces = edges.slice(1).map((end, i) => nights.map((_, at) => at).filter((at) => nights[at] >= edges[i] && nights[at] < end)).filter((piece) => piece.length);
  const last = pieces.at(-1), of = (values, piece) => piece.map((at) => values[at]);
  const low = of(fitted, last).map((value, i) => value - half[last[i]]), high = of(fitted, last).map((value, i) => value + half[last[i]]);
  const banded = nights[last[0]] >= edges.at(-2) ? [band(of(nights, last), low, high, "fit")] : [];
  return [...banded, ...pieces.map((piece) => line(of(nights, piece), of(fitted, piece), "fit"))];
}

export function drifting(trend) {
  const { values, unit, drift_a_night: drift, drift_standard_uncertainty: sigma } = trend;
  const now = say("trend.now", { value: number(values.at(-1), 2), unit }), digits = rateDigits(COVERAGE * sigma);
  if (drift === null || !longEnough(trend)) return `${now} · ${say("trend.too_few")}`;
  const left = leftOf(trend);
  if (!hasSlope(trend)) return `${now} · ${say("trend.no_drift", { doubt: number(COVERAGE * sigma, digits), unit })}${left}`;
  const rate = say("trend.drift", { drift: number(drift, digits), doubt: number(COVERAGE * sigma, digits), unit });
  return `${now} · ${rate}${left}`;
}

/* When the tolerance is reached: the date with its range and the probability, or the nights left if there are too few values for that. */
function leftOf(trend) {
  const { forecast, nights_left } = trend;
  if (!forecast) return nights_left === null || !hasSlope(trend) ? "" : ` · ${say("trend.left", { nights: number(nights_left, 0) })}`;
  const [low, middle, high] = forecast.dates.map((date) => (date === null ? say("trend.later") : dayOfDate(date)));
  const within = forecast.within_nights, decimals = Number.isInteger(within) ? 0 : 1;
  const soon = say("trend.soon", { share: number(100 * forecast.probability, 0), nights: number(within, decimals) });
  return ` · ${forecast.nights_to[1] === null ? "" : `${say("trend.due", { middle, low, high })}, `}${soon}`;
}

/* Drift per night with its uncertainty, or that there is none. */
export function rateOf(trend) {
  const { drift_a_night: drift, drift_standard_uncertainty: sigma } = trend, digits = rateDigits(COVERAGE * sigma), doubt = number(COVERAGE * sigma, digits);
  if (drift === null || !longEnough(trend)) return "–";
  return hasSlope(trend) ? say("parameters.rate", { drift: number(drift, digits), doubt }) : say("plant.no_drift", { doubt });
}

/* Key of the lines, and of the `marks` that occur. */
export function keyOfLines(marks = []) {
  const kinds = ["value", "fit", "forecast", "control", "tolerance", "due", "step"];
  const occurring = [...new Set(marks.map(({ kind }) => kind))];
  return make("p", { className: "remark lines" }, ...kinds.map((kind) => make("span", { className: kind }, say(`trend.line_${kind}`))),
    ...occurring.map((kind) => make("span", { className: `event ${kind}` }, say(`trend.mark_${kind}`))));
}

export function alarmList(alarms) {
  return alarms.length ? [make("ul", { className: "trend-alarms" }, ...alarms.map(({ kind, text, hint }) => make("li", {}, make("b", {}, say(`trend.alarm_${kind}`)), " ", told(text), ...(hint ? [make("br"), told(hint)] : []))))] : [];
}
