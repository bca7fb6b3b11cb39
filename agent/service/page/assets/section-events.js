/* Section with the events of a run from the journal. Alarms need a reaction and are shown in the operator view. */
import { make } from "./dom.js";
import { instant, known, number, say } from "./language.js";
import { choice, heading, remark, table, wordOr } from "./parts.js";
import { read } from "./requests.js";
import { told } from "./sentences.js";
import { reasonText, stateWord, stepWords } from "./wording.js";

export const ofRun = true, needsEstimate = false;
const MOST = 1000;
const KINDS = ["all", "state", "note", "measured", "asked"];
const SENTENCES = ["text", "note", "reason", "error", "then"], LENGTHS = ["drift_um", "off_mm"];
let shown = "all";

export async function parts({ run, again }) {
  const events = (await read(`/api/runs/${encodeURIComponent(run)}/events?limit=${MOST}`)).map((event) => ({ ...event, group: groupOf(event) })).reverse();
  const wanted = events.filter(({ group }) => shown === "all" || group === shown);
  const chosen = (kind) => {
    shown = kind;
    again({ quiet: true });
  };
  return [
    heading("events.title"),
    choice("events.filter", KINDS.map((kind) => [kind, `events.${kind}`]), shown, chosen),
    wanted.length ? table(["events.when", "events.what", "events.text"].map((key) => say(key)), wanted.map((event) => [instant(event.at), say(`events.${event.group}`), textOf(event)]))
      : remark("events.none"),
  ];
}

const groupOf = ({ kind }) => ({ state: "state", note: "note", event: "measured", asked: "asked", request: "asked", acknowledged: "asked" })[kind] ?? "note";

function textOf({ kind, record }) {
  if (kind === "state") return [stateWord(record.state), record.reason && reasonText(record.reason)].filter(Boolean).join(" – ");
  if (kind === "asked") return [wordOr("kind", record.kind ?? ""), wordOr("source", (record.source ?? "").replaceAll(" ", "_")), record.by].filter(Boolean).join(" – ");
  if (kind === "acknowledged") return [say("events.acknowledged"), record.by].filter(Boolean).join(" – ");
  if (kind === "request") return [told(record.text), record.by].filter(Boolean).join(" – ");
  const { step } = record;
  const where = step ? [make("span", { title: step }, stepWords(step))] : [];
  const sentences = SENTENCES.filter((name) => record[name]).map((name) => reasonText(record[name]));
  return make("span", { className: "event-text" }, ...where, sentences.join("; "), make("small", {}, Object.entries(record).map(inWords).filter(Boolean).join(" · ")));
}

/* An entry without words in the catalogue is for programs alone. */
function inWords([name, value]) {
  const key = `record.${name}`;
  return known(key) && value !== null && value !== "" ? say(key, { value: figure(name, value) }) : null;
}

function figure(name, value) {
  if (Array.isArray(value)) return LENGTHS.includes(name) ? figure(name, Math.hypot(...value)) : value.map((one) => figure(name, one)).join(" / ");
  return typeof value === "number" ? number(value, Number.isInteger(value) ? 0 : 2) : value;
}
