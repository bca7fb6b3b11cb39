/* Section with the alarms of all runs, the latest first: number, since when, until when, cause and run. */
import { make } from "./dom.js";
import { instant, known, number, say } from "./language.js";
import { heading, pager, remark, table, wordOr } from "./parts.js";
import { read } from "./requests.js";
import { told } from "./sentences.js";
import { seen } from "./store.js";
import { whereWords } from "./wording.js";

export const ofRun = false;
const PAGE = 25;
let offset = 0;

export async function parts({ again }) {
  const { alarms, total } = await read(`/api/history/alarms?limit=${PAGE}&offset=${offset}`);
  if (!total) return [heading("alarms.title"), remark("alarms.none")];
  const heads = ["number", "since", "until", "cause", "run"].map((key) => say(`alarms.${key}`));
  const go = (to) => {
    offset = to;
    return again({ quiet: true });
  };
  return [heading("alarms.title"), remark("alarms.is"), table(heads, alarms.map(row), "alarms"), pager(offset, PAGE, total, go)];
}

/* An alarm between runs is open until its end is recorded. */
const isOpen = (run) => !run || (seen.status?.run_id === run && seen.status.alarms.length > 0);

function row({ since, until, run_id, kind, alarm: { code, text, where } }) {
  const meaning = known(`alarm.${code}`) ? make("b", {}, say(`alarm.${code}`)) : null;
  const place = whereWords(where);
  return [number(code, 0), instant(since), until === null ? say(isOpen(run_id) ? "alarms.open" : "alarms.not_recorded") : instant(until),
    make("div", { className: "cause" }, meaning, make("div", {}, told(text)), place ? make("small", { title: where.step ?? "" }, place) : null),
    run_id ? make("div", {}, wordOr("kind", kind), make("br"), make("small", {}, run_id)) : say("alarms.between")];
}
