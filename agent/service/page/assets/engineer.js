/* Engineer view: one section at a time; sections about a run show the chosen run. */
import { onAccess } from "./access.js";
import { byId, make } from "./dom.js";
import { onLanguage, say } from "./language.js";
import { runName } from "./parts.js";
import { read, Refused } from "./requests.js";
import * as alarms from "./section-alarms.js";
import * as compared from "./section-compare.js";
import * as curves from "./section-curves.js";
import * as design from "./section-design.js";
import * as events from "./section-events.js";
import * as maps from "./section-map.js";
import * as parameters from "./section-parameters.js";
import * as part from "./section-part.js";
import * as plant from "./section-plant.js";
import * as reports from "./section-reports.js";
import * as settings from "./section-settings.js";
import * as tables from "./section-tables.js";
import * as temperatures from "./section-temperatures.js";
import * as trend from "./section-trend.js";
import { told } from "./sentences.js";
import { on, seen } from "./store.js";

const SECTIONS = { reports, map: maps, curves, part, compare: compared, trend, parameters, design, tables, events, alarms, temperatures, settings, plant };
const RUNS = 50, TRIED = 5;

const now = { section: "map", run: null, older: null, runs: [], asked: 0, shown: false };

export function openEngineer() {
  const view = byId("view-engineer");
  const list = make("nav", { className: "sections", id: "sections" });
  const chooser = make("select", { id: "run", onchange: () => choose(now.section, chooser.value) });
  const label = make("label", { className: "of-run" }, make("span", {}), chooser);
  const content = make("section", { className: "content", id: "content", tabIndex: 0 });
  view.replaceChildren(list, make("div", { className: "sheet" }, label, content));
  onLanguage(() => now.shown && show());
  onAccess(() => now.shown && show({ quiet: true }));
  on("status", ({ run_id, state }) => {
    const key = `${run_id} ${state}`;
    if (now.key !== key && now.shown) refresh();
    now.key = key;
  });
  on("event", () => now.shown && now.section === "events" && isCurrent() && show({ quiet: true }));
}

export function enterEngineer() {
  now.shown = true;
  now.key = `${seen.status?.run_id} ${seen.status?.state}`;
  return refresh();
}

export const leaveEngineer = () => (now.shown = false);

const isCurrent = () => now.run === null || now.run === seen.status?.run_id;

async function refresh() {
  try {
    now.runs = (await read(`/api/runs?limit=${RUNS}`)).runs;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    now.runs = [];
  }
  keepOlder();
  if (!now.runs.some(({ run_id }) => run_id === now.run)) now.run = null;
  await show();
}

/* A run that was opened from the list of all runs stays among the latest ones that can be chosen. */
function keepOlder() {
  if (now.older && !now.runs.some(({ run_id }) => run_id === now.older.run_id)) now.runs = [...now.runs, now.older];
}

/* Opens a section, with the run if one is given. */
function open(section, run = null) {
  now.older = run ?? now.older;
  keepOlder();
  return choose(section, run?.run_id ?? now.run);
}

function choose(section, run) {
  now.section = section;
  now.run = run;
  return show();
}

/* On a phone, the list of the sections fills the screen: then what was chosen comes into view. The button keeps the focus. */
async function enter(name) {
  await choose(name, now.run);
  byId(`section-${name}`).focus({ preventScroll: true });
  const main = document.querySelector("main");
  if (main.scrollHeight > main.clientHeight) byId("content").closest(".sheet").scrollIntoView();
}

/* Runs that the section can show: the chosen one, otherwise the latest ones that may have the data it needs. */
function candidates({ needsEstimate }) {
  if (now.run !== null) return [now.run];
  const latest = needsEstimate ? now.runs.filter(({ state }) => state === "complete").slice(0, TRIED) : [];
  return (latest.length ? latest : now.runs.slice(0, 1)).map(({ run_id }) => run_id);
}

/* Content of the section for the first run that has the data it needs, and that run. */
async function partsOf(section) {
  if (!section.ofRun) return { run: null, parts: await section.parts({ runs: now.runs, again: show, open }) };
  const runs = candidates(section);
  if (!runs.length) {
    const instead = section.withoutRun ? await section.parts({ run: null, runs: [], again: show, open }) : [make("p", { className: "remark" }, say("section.no_run"))];
    return { run: null, parts: instead };
  }
  for (const run of runs) {
    try {
      return { run, parts: await section.parts({ run, runs: now.runs, again: show, open }) };
    } catch (error) {
      if (!(error instanceof Refused) || run === runs.at(-1)) throw error;
    }
  }
}

async function show({ quiet = false } = {}) {
  const mine = ++now.asked, section = SECTIONS[now.section], content = byId("content");
  byId("sections").replaceChildren(...Object.keys(SECTIONS).map((name) => make("button", {
    id: `section-${name}`, ariaCurrent: name === now.section ? "page" : "false", onclick: () => enter(name),
  }, say(`section.${name}`))));
  showRuns(section, candidates(section)[0] ?? null);
  if (!quiet) content.replaceChildren(make("p", { className: "remark busy" }, say("section.loading")));
  content.setAttribute("aria-label", say(`section.${now.section}`));
  content.setAttribute("aria-busy", "true");
  try {
    const { run, parts } = await partsOf(section);
    if (mine !== now.asked) return;
    content.replaceChildren(...parts);
    showRuns(section, run);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (mine === now.asked) content.replaceChildren(complaint(error.problem));
  } finally {
    if (mine === now.asked) content.removeAttribute("aria-busy");
  }
}

function showRuns(section, shown) {
  const chooser = byId("run");
  chooser.closest("label").hidden = !section.ofRun || now.runs.length === 0;
  chooser.previousSibling.textContent = say("run.choose");
  chooser.replaceChildren(...now.runs.map((run) => make("option", { value: run.run_id, selected: run.run_id === shown }, runName(run))));
}

function complaint({ detail, hint }) {
  return make("section", { className: "card" }, make("h2", {}, say("section.nothing")), make("p", {}, told(detail)),
    hint ? make("p", { className: "remark" }, told(hint)) : null);
}
