/* Card of the last run while no run is in progress: its verdict, its figures and its report. */
import { make } from "./dom.js";
import { instant, languageNow, number, onLanguage, say } from "./language.js";
import { beforeAfter, facts, micrometres, wordOr } from "./parts.js";
import { read, Refused } from "./requests.js";
import { on, seen } from "./store.js";
import { AT_REST, reasonText, verdictMark } from "./wording.js";

const LAST = "/api/runs?limit=1";
const now = { key: null, run: null, unanswered: false };

export function openResult(place) {
  const show = () => render(place);
  on("status", async ({ state, run_id, balls }) => {
    const key = AT_REST.has(state) ? `${state} ${run_id} ${balls}` : null;
    if (key !== now.key || now.unanswered) {
      Object.assign(now, { key, unanswered: false });
      const run = key === null ? null : await lastRun();
      if (now.key !== key) return;
      Object.assign(now, { run: run ?? null, unanswered: run === undefined });
    }
    show();
  });
  onLanguage(show);
}

/* Undefined if the service did not answer: the next status asks again. */
async function lastRun() {
  try {
    return (await read(LAST)).runs[0] ?? null;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    return undefined;
  }
}

/* A run that was refused before it began is not in the journal: then the status alone says how it ended. */
function render(place) {
  const { status } = seen, { run } = now;
  const own = status?.verdict && status.run_id !== run?.run_id ? { verdict: status.verdict, kind: status.kind, started: status.started } : run;
  const shown = JSON.stringify([now.key && own, Boolean(status?.verdict), document.documentElement.lang]);
  if (place.dataset.shown === shown) return;
  place.dataset.shown = shown;
  place.replaceChildren(...(now.key !== null && own ? [card(own, own === run)] : []));
}

function card(run, stored) {
  const { run_id, kind, started, verdict, reason } = run;
  const made = make("section", { className: "card result", id: "result" },
    make("h2", {}, verdictMark(verdict)),
    make("p", { className: "remark" }, [`${say("result.last")} ${wordOr("kind", kind)}`, started ? instant(started) : null].filter(Boolean).join(", ")),
    seen.status.verdict ? null : make("p", {}, say(`verdict.${verdict.name}.is`)),
    reason ? make("p", { className: "where" }, reasonText(reason)) : null,
    stored ? figures(run) : null,
    stored && run.ended ? make("a", { className: "button", id: "result-report", href: `/api/page/runs/${encodeURIComponent(run_id)}/report.html?language=${languageNow()}`, download: "" }, say("result.report")) : null);
  made.dataset.look = verdict.look;
  return made;
}

const figures = ({ ve_um, vce_um, held_out_before_um, held_out_after_um, balls, machine_minutes }) => facts([
  ["fact.ve_before", micrometres(ve_um)],
  ["fact.ve_now", micrometres(vce_um)],
  ["fact.held_out", beforeAfter(held_out_before_um, held_out_after_um)],
  ["fact.balls", number(balls, 0)],
  ["fact.minutes", number(machine_minutes, 1)],
]);
