/* Section with all runs of the machine: selected by kind, verdict, date and text, with their reports; two of them are
   compared. Below, the diagnostics archive for support. */
import { permits } from "./access.js";
import { askAccess } from "./access-dialog.js";
import { make } from "./dom.js";
import { languageNow, minute, number, say } from "./language.js";
import { showProblem } from "./notices.js";
import { field, heading, pager, remark, table, wordOr } from "./parts.js";
import { fetchFile, isTokenRefused, read, Refused, token } from "./requests.js";
import { compare } from "./section-compare.js";
import { told } from "./sentences.js";
import { reasonText, verdictMark } from "./wording.js";

export const ofRun = false;
const PAGE = 25, COMPARED = 2, DATES = { min: "2000-01-01", max: "9998-12-31" };
const wanted = { kind: "", verdict: "", since: "", until: "", text: "" };
let offset = 0, chosen = [], unfolded = false;

export async function parts({ runs, again, open }) {
  const found = await listed(runs);
  const choosers = filters(found, again);
  return [heading("reports.title"), comparison(open, choosers), choosers, ...(found.problem ? [make("p", { className: "remark" }, found.problem)] : []),
    rows(found, again, open), pager(offset, PAGE, found.total, (to) => go(to, again)), ...diagnosing()];
}

/* The selected runs from the history; if its database cannot be read, the latest runs of the journal. */
async function listed(latest) {
  const query = new URLSearchParams({ limit: PAGE, offset });
  for (const key of ["kind", "verdict", "text"]) if (wanted[key]) query.set(key, wanted[key]);
  if (wanted.since) query.set("since", dayAt(wanted.since, 0));
  if (wanted.until) query.set("until", dayAt(wanted.until, 1));
  try {
    return await read(`/api/history/runs?${query}`);
  } catch (error) {
    if (!(error instanceof Refused) || error.problem.status !== 503) throw error;
    const shown = latest.map((run) => ({ ...run, number: null, report: run.ended !== null }));
    return { runs: shown, total: shown.length, kinds: {}, verdicts: {}, problem: say("reports.no_history", { detail: told(error.problem.detail) }) };
  }
}

/* Beginning of a local day, or of the one `later`, in UTC. */
function dayAt(day, later) {
  const [year, month, date] = day.split("-").map(Number);
  return new Date(year, month - 1, date + later).toISOString();
}

function go(to, again) {
  offset = to;
  return again({ quiet: true });
}

function filters({ kinds, verdicts }, again) {
  const changed = (key) => (event) => {
    if (!event.target.validity.valid) return undefined;
    wanted[key] = event.target.value.trim();
    return go(0, again).then(() => document.getElementById(event.target.id)?.focus());
  };
  const options = (key, counts, word) => field(`reports.${key}`, make("select", { id: `filter-${key}`, onchange: changed(key) },
    make("option", { value: "" }, say("reports.all")), ...Object.entries(counts).map(([name, count]) =>
      make("option", { value: name, selected: name === wanted[key] }, say("reports.counted", { word: word(name), count: number(count, 0) })))));
  const input = (key, type, more = {}) => field(`reports.${key}`, make("input", { id: `filter-${key}`, type, value: wanted[key], onchange: changed(key), ...more }));
  return make("div", { className: "choosers", id: "filters" }, options("kind", kinds, (name) => wordOr("kind", name)), options("verdict", verdicts, (name) => wordOr("verdict", name)),
    input("since", "date", DATES), input("until", "date", DATES), input("text", "search", { maxLength: 100, title: say("reports.text_is") }));
}

/* On a small screen the runs come first: a button unfolds the filters, and says how many are set. Others show them always. */
function unfolding(choosers) {
  const set = Object.values(wanted).filter(Boolean).length;
  const button = make("button", { className: "unfold", onclick: () => {
    unfolded = !unfolded;
    show();
  } }, set ? `${say("reports.filter")} (${number(set, 0)})` : say("reports.filter"));
  const show = () => {
    choosers.classList.toggle("folded", !unfolded);
    button.setAttribute("aria-expanded", String(unfolded));
  };
  button.setAttribute("aria-controls", choosers.id);
  show();
  return button;
}

function comparison(open, choosers) {
  return make("div", { className: "acts" }, unfolding(choosers), make("button", { id: "compare", disabled: chosen.length < COMPARED, onclick: () => {
    const [one, other] = [...chosen].sort((a, b) => a.started.localeCompare(b.started));
    compare(one, other);
    return open("compare");
  } }, say("reports.compare")), make("span", { className: "remark" }, say("reports.compare_is", { count: number(chosen.length, 0) })));
}

function rows({ runs }, again, open) {
  if (!runs.length) return remark("reports.none");
  const heads = ["reports.compare_head", "reports.number", "reports.run", "reports.kind", "reports.state", "reports.ve", "reports.held_out", "fact.minutes", "reports.report"];
  return table(heads.map((key) => say(key)), runs.map((run) => row(run, again, open)), "runs");
}

const arrow = (before, after) => (after === null ? number(before, 2) : `${number(before, 2)} → ${number(after, 2)}`);

function row(run, again, open) {
  const { run_id, number: count, kind, started, verdict, reason, report, ve_um, vce_um, held_out_before_um, held_out_after_um, machine_minutes } = run;
  const link = (form) => make("a", { className: "button", href: `/api/page/runs/${encodeURIComponent(run_id)}/report.${form}?language=${languageNow()}`, download: "" }, say(`reports.${form}`));
  const name = say("reports.choose", { run: `${minute(started)} ${wordOr("kind", kind)}` });
  const box = make("input", { type: "checkbox", ariaLabel: name, checked: chosen.some((one) => one.run_id === run_id), disabled: !report, onchange: () => {
    chosen = [...chosen.filter((one) => one.run_id !== run_id), ...(box.checked ? [run] : [])].slice(-COMPARED);
    return again({ quiet: true });
  } });
  const when = report ? make("button", { className: "plain", title: say("reports.show_is"), onclick: () => open("map", run) }, minute(started)) : minute(started);
  return [make("label", { className: "tick" }, box), number(count, 0), when, wordOr("kind", kind), make("span", { title: reason ? reasonText(reason) : "" }, verdictMark(verdict)),
    arrow(ve_um, vce_um), arrow(held_out_before_um, held_out_after_um), number(machine_minutes, 1),
    make("span", { className: "acts" }, ...(report ? [link("html"), link("pdf")] : [verdict.name === "running" ? say("reports.going_on") : null]))];
}

const diagnosing = () => (permits("diagnostics") ? [make("div", { className: "acts" }, make("button", { id: "diagnostics", onclick: diagnostics }, say("reports.diagnostics"))), remark("reports.diagnostics_is")] : []);

/* The archive contains everything known about the machine, so it requires a token: a request instead of a link. */
async function diagnostics() {
  if (!token() && !(await askAccess())) return;
  try {
    const address = URL.createObjectURL(await fetchFile("/api/diagnostics"));
    const link = make("a", { href: address, download: "volcal-diagnostics.zip" });
    link.click();
    URL.revokeObjectURL(address);
  } catch (error) {
    showProblem(error);
    if (isTokenRefused(error) && (await askAccess(say("access.refused")))) await diagnostics();
  }
}
