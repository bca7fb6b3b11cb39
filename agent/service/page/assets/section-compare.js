/* Section that compares two runs: figures, the 21 errors, the error field and the tables written; second minus first. */
import { band, chart, line } from "./chart.js";
import { make } from "./dom.js";
import { instant, number, say } from "./language.js";
import { beforeAfter, field, heading, micrometres, remark, runName, table, tableDifference, wordOr } from "./parts.js";
import { planeMaps } from "./plane-map.js";
import { read } from "./requests.js";
import { verdictMark } from "./wording.js";

export const ofRun = false;
const SIGMAS = 2, MM_DIGITS = 0;
const ROOM = { left: 34, right: 6, top: 22, bottom: 22 };
const pair = { one: null, other: null };

/* Chooses the two runs, which need not be among the latest ones. */
export function compare(one, other) {
  Object.assign(pair, { one, other });
}

export async function parts({ runs, again }) {
  const ended = runs.filter((run) => run.ended !== null), identified = ended.filter(({ kind, ve_um }) => kind === "calibrate" && ve_um !== null);
  const latest = identified.length > 1 ? identified : ended;
  pair.other ??= latest[0] ?? null;
  pair.one ??= latest[1] ?? null;
  if (!pair.one || !pair.other) return [heading("compare.title"), remark("compare.too_few")];
  const choosers = make("div", { className: "choosers" }, ...Object.keys(pair).map((side) => chooser(side, ended, again)));
  const found = await read(`/api/page/comparison?one=${encodeURIComponent(pair.one.run_id)}&other=${encodeURIComponent(pair.other.run_id)}`);
  return [heading("compare.title"), choosers, figuresOf(found.runs), ...errorsOf(found.identified), ...tablesOf(found.tables)];
}

function chooser(side, ended, again) {
  const known = ended.some(({ run_id }) => run_id === pair[side].run_id) ? ended : [...ended, pair[side]];
  const select = make("select", { id: `run-${side}`, onchange: () => {
    pair[side] = known.find(({ run_id }) => run_id === select.value);
    return again({ quiet: true });
  } }, ...known.map((run) => make("option", { value: run.run_id, selected: run.run_id === pair[side].run_id }, runName(run))));
  return field(`compare.${side}`, select);
}

const change = (values, digits) => (values.some((value) => value === null) ? "–" : signed(values[1] - values[0], digits));
const signed = (value, digits) => `${value > 0 ? "+" : ""}${number(value, digits)}`;

function figuresOf([one, other]) {
  const rows = [
    [say("reports.run"), instant(one.started), instant(other.started), ""],
    [say("reports.kind"), wordOr("kind", one.kind), wordOr("kind", other.kind), ""],
    [say("reports.state"), verdictMark(one.verdict), verdictMark(other.verdict), ""],
    ...[["fact.ve_before", "ve_um"], ["fact.ve_now", "vce_um"]].map(([key, name]) =>
      [say(key), micrometres(one[name]), micrometres(other[name]), change([one[name], other[name]], 2)]),
    [say("fact.held_out"), ...[one, other].map((run) => beforeAfter(run.held_out_before_um, run.held_out_after_um)), ""],
    [say("fact.balls"), number(one.balls, 0), number(other.balls, 0), change([one.balls, other.balls], 0)],
    [say("fact.minutes"), number(one.machine_minutes, 1), number(other.machine_minutes, 1), change([one.machine_minutes, other.machine_minutes], 1)],
  ];
  return table(["", say("compare.one"), say("compare.other"), say("compare.change")], rows, "compact");
}

function errorsOf({ reason, errors, field: changed }) {
  const title = make("h3", {}, say("compare.errors"));
  if (reason) return [title, remark(`compare.missing_${reason.replace("-", "_")}`)];
  const curves = errors.filter(({ at_mm: at }) => at !== null);
  const reaches = new Map(["µm", "µrad"].map((unit) => [unit, largest(curves.filter((curve) => curve.unit === unit))]));
  const order = [...errors].sort((a, b) => share(b) - share(a));
  return [title, remark("compare.errors_is"), make("div", { className: "curves" }, ...curves.map((curve) => panel(curve, reaches))),
    table(["compare.error", "compare.largest", "compare.at", "compare.judged"].map((key) => say(key)), order.map(row), "compact"), ...fieldOf(changed)];
}

const share = ({ largest: value, expanded_uncertainty: doubt }) => Math.abs(value) / (doubt || 1);
const largest = (curves) => Math.max(1e-3, ...curves.flatMap(({ difference, sigma }) => difference.map((v, i) => Math.abs(v) + SIGMAS * sigma[i])));

function row({ name, unit, largest: value, at_mm: at, expanded_uncertainty: doubt, significant }) {
  return [name, say("unit.with_doubt", { value: signed(value, 2), doubt: number(doubt, 2), unit }), at === null ? "–" : say("unit.value", { value: number(at, MM_DIGITS), unit: "mm" }),
    say(significant ? "compare.significant" : "compare.within")];
}

function panel({ name, unit, position_mm: at, difference, sigma }, reaches) {
  const top = 1.05 * reaches.get(unit), kind = unit === "µm" ? "displacement" : "rotation";
  const low = difference.map((v, i) => v - SIGMAS * sigma[i]), high = difference.map((v, i) => v + SIGMAS * sigma[i]);
  return chart({
    title: name, name: say("compare.panel", { name }), xLabel: "", yLabel: unit, x: [at[0], at.at(-1)], y: [-top, top], width: 190, height: 130, room: ROOM,
    ticksX: 2, unitX: "mm", draws: [band(at, low, high, kind), line(at, difference, kind)],
  });
}

function fieldOf(found) {
  const at = found.at_mm.map((value) => number(value, MM_DIGITS)).join(" / ");
  return [make("h3", {}, say("compare.field")), make("p", {}, say("compare.field_is", { rms: number(found.rms_um, 2), largest: number(found.largest_um, 2), at })),
    ...planeMaps(found.planes)];
}

function tablesOf(tables) {
  const title = make("h3", {}, say("compare.tables"));
  if (tables.reason) return [title, remark(`compare.missing_${tables.reason.replace("-", "_")}`)];
  return [title, tableDifference(tables), ...(tables.same ? [] : [remark("compare.tables_is"), ...planeMaps(tables.planes)])];
}
