/* Section with the events of a run from the journal. Alarms need a reaction and are shown in the operator view. */
import { make } from "./dom.js";
import { instant, number, say } from "./language.js";
import { choice, heading, remark, table, wordOr } from "./parts.js";
import { read } from "./requests.js";
import { stateWord, stepWords } from "./wording.js";

export const ofRun = true, needsEstimate = false;
const MOST = 1000;
const KINDS = ["all", "state", "note", "measured", "asked"];
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

const groupOf = ({ kind }) => ({ state: "state", note: "note", event: "measured", asked: "asked", acknowledged: "asked" })[kind] ?? "note";

function textOf({ kind, record }) {
  if (kind === "state") return [stateWord(record.state), record.reason].filter(Boolean).join(" – ");
  if (kind === "asked") return [wordOr("kind", record.kind ?? ""), wordOr("source", (record.source ?? "").replaceAll(" ", "_")), record.by].filter(Boolean).join(" – ");
  if (kind === "acknowledged") return [say("events.acknowledged"), record.by].filter(Boolean).join(" – ");
  const { text, step, ...rest } = record;
  const where = step ? [stepWords(step), make("code", {}, step)] : [];
  return make("span", { className: "event-text" }, ...where, text ?? "", make("small", {}, Object.entries(rest).filter(([, value]) => plain(value)).map(([name, value]) => `${name} ${figure(value)}`).join(" · ")));
}

const plain = (value) => ["number", "string"].includes(typeof value) || (Array.isArray(value) && value.every((one) => typeof one === "number"));
const figure = (value) => (Array.isArray(value) ? value.map(figure).join(" / ") : typeof value === "number" ? number(value, Number.isInteger(value) ? 0 : 2) : value);
