/* Plain-text status of the machine from its state and the key of the step. */
import { make } from "./dom.js";
import { known, number, say } from "./language.js";
import { told } from "./sentences.js";

const MOVING = new Set(["measuring", "verifying", "held"]);
const CHECKS = new Set(["probe-check", "qualification", "reversal", "homing"]);
const KEY = /^([\w-]+)(?:\/station-(\d+))?(?:\/az(-?[\d.]+)-el(-?[\d.]+))?(?:\/ball-(\d+))?/;

export const LOOKS = {
  idle: "quiet", preflight: "busy", resuming: "busy", measuring: "busy", held: "held", identifying: "busy",
  staging: "busy", activating: "busy", verifying: "busy", restoring: "busy", "written, not active": "held",
  complete: "done", refused: "refused", aborting: "fault", aborted: "fault", faulted: "fault",
};

const named = (state) => state.replaceAll(/[ ,]+/g, "_");
export const stateWord = (state) => say(`state.${named(state)}`);

/* Verdict on a run, from the one table of the service, as a coloured sign with its word; the sentence is its title. */
export const verdictWord = ({ name }) => say(`verdict.${name}`);
export function verdictMark(verdict) {
  const sign = make("span", { className: "sign", ariaHidden: "true" }, verdict.sign);
  const mark = make("span", { className: "verdict", title: say(`verdict.${verdict.name}.is`) }, sign, " ", verdictWord(verdict));
  mark.dataset.look = verdict.look;
  mark.dataset.verdict = verdict.name;
  return mark;
}

const WRITTEN = "written, not active";
export const AT_REST = new Set(["idle", "complete", "refused", WRITTEN, "aborted", "faulted"]);

/* An idle machine is ready only if nothing is left to be dealt with. */
function idleWords({ unfinished, alarms }) {
  if (alarms.length) return say("doing.idle_alarm");
  return say(unfinished === null ? "doing.idle" : "doing.idle_unfinished");
}

/* The look of the badge: idle is quiet only if nothing is left to be dealt with. */
export function lookOf({ state, verdict, unfinished, alarms }) {
  if (verdict) return verdict.look;
  if (state === "idle" && alarms.length) return "fault";
  return state === "idle" && unfinished !== null ? "held" : LOOKS[state] ?? "quiet";
}

/* Word of a state without a verdict. A machine is not called idle while something is left to be dealt with, and a table
   that is active after all is not called inactive. */
export function restWord({ state, unfinished, alarms, unproved }) {
  const left = state === "idle" ? unproved || unfinished !== null || alarms.length : state === WRITTEN && unproved;
  return left ? say("unproved.not_ready") : stateWord(state);
}

export function doing(status) {
  const { state, step, unproved, verdict } = status;
  if (unproved && AT_REST.has(state)) {
    return say("doing.unproved", { state: restWord(status), bank: unproved.bank });
  }
  if (verdict && AT_REST.has(state)) return say(`verdict.${verdict.name}.is`);
  if (state === "idle") return idleWords(status);
  const words = say(`doing.${state === "measuring" && CHECKS.has(status.phase) ? status.phase : named(state)}`);
  const where = MOVING.has(state) ? stepWords(step) : "";
  return where ? `${words}: ${where}` : words;
}

/* Kind of the run in progress, or of the one whose end is shown, its position set, and who started it. */
export function runText({ kind, position_set: set, by }) {
  if (!kind) return "";
  const name = known(`kind.${kind}`) ? say(`kind.${kind}`) : kind;
  return [name, kind === "calibrate" ? set : null, by ? say("run.started_by", { name: by }) : null].filter(Boolean).join(" · ");
}

/* Phase of the run with its progress; of a preflight without a former one, the number of steps simulated so far. */
export function phaseText({ phase, phase_fraction: fraction, phase_minutes_left: minutes, simulated_steps: steps }) {
  if (!phase) return "";
  const name = say(`phase.${named(phase)}`);
  const parts = [fraction === null ? null : `${number(Math.round(100 * fraction), 0)} %`];
  if (minutes !== null) parts.push(say(minutes < 1 ? "progress.seconds" : "progress.left", { minutes: number(Math.ceil(minutes), 0), seconds: number(Math.ceil(60 * minutes), 0) }));
  if (phase === "preflight" && fraction === null) parts.push(steps ? say("progress.simulated", { steps: number(steps, 0) }) : say("progress.planning"));
  return [name, ...parts].filter(Boolean).join(" · ");
}

export function placeOf(step) {
  const found = KEY.exec(step ?? "");
  if (!found?.[2]) return null;
  const [, phase, station, azimuth, elevation, ball] = found;
  return { phase, station: Number(station), azimuth, elevation, ball: ball === undefined ? null : Number(ball) };
}

/* A ball that could not be measured was not found if a touch met nothing where it should be. It was rejected for any other
   reason, such as a touch that met nothing only when it was repeated. Older journals give no reason. */
export const wasRejected = ({ reason }) => Boolean(reason) && !/\bmet nothing\b(?! when it was repeated)/.test(reason);

/* A ball that could not be measured, in words; a key without a ball is told as a place, or as it is. */
function lostText(key, data) {
  const ball = placeOf(key)?.ball ?? null;
  if (ball === null) return stepWords(key) || key;
  return say(wasRejected(data) ? "event.rejected" : "event.lost", { ball, place: stepWords(key.replace(/\/ball-.*/, "")) });
}

/* Text of an event from the catalogue if it has one, otherwise the text of the service. */
export function eventText({ kind, text, data }) {
  if (kind === "state") return stateWord(data.state);
  if (kind === "lost") return lostText(text, data);
  if (kind === "alarm") return say("event.alarm", { code: data.code });
  if (kind === "outcome") return data.verdict ? verdictWord(data.verdict) : stateWord(data.state);
  return told(text);
}

/* Reason for the end of a run; the places of an error are named in words, not by their keys. */
export const reasonText = (reason) => told(reason)
  .replaceAll(/\bstep ([a-z-]+\/[^\s,)]*)/g, (_, key) => `${say("where.step")} ${stepWords(key) || key}`)
  .replaceAll(/\((device) /g, `(${say("where.device")} `);

/* Places of an alarm, each with its name: the step in words, all else as the service says it. */
export const whereWords = (where) => Object.entries(where).map(([name, value]) =>
  `${known(`where.${name}`) ? say(`where.${name}`) : name}: ${(name === "step" && stepWords(value)) || value}`).join(" · ");

/* Station, orientation and ball of a step in words; empty if it has none. */
export function stepWords(step) {
  const at = placeOf(step);
  if (!at) return "";
  const parts = [say("place.station", { station: at.station })];
  if (at.azimuth !== undefined) {
    parts.push(say("place.angles", { azimuth: number(Number(at.azimuth), 0), elevation: number(Number(at.elevation), 0) }));
  }
  if (at.ball !== null) parts.push(say("place.ball", { ball: at.ball }));
  return parts.join(", ");
}
