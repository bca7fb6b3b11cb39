/* Operator view: current action, remaining time, alarms and questions. */
import { request } from "./controls.js";
import { askConfirmation } from "./dialogs.js";
import { byId, make } from "./dom.js";
import { inEnglish, instant, known, number, onLanguage, say, timeOfDay } from "./language.js";
import { micrometres } from "./parts.js";
import { read, Refused } from "./requests.js";
import { openResiduals } from "./residuals.js";
import { openResult } from "./result-card.js";
import { openScene } from "./scene.js";
import { on, seen } from "./store.js";
import { told } from "./sentences.js";
import { AT_REST, doing, eventText, phaseText, runText, whereWords } from "./wording.js";

const RECENT = 4, MINUTE_S = 60;

const FACTS = [
  ["fact.ve_before", ({ ve_before_um }) => micrometres(ve_before_um)],
  ["fact.ve_now", ({ ve_now_um }) => micrometres(ve_now_um)],
  ["fact.balls", ({ balls }) => number(balls, 0)],
  ["fact.bank", bankText],
];

export function openOperator() {
  const view = byId("view-operator");
  const kind = make("p", { className: "kind", id: "kind" });
  const words = make("p", { className: "doing", id: "doing" });
  const whole = progressBar("track"), own = progressBar("track own");
  const percent = make("span"), left = make("span", { id: "minutes-left" });
  const phase = make("p", { className: "phase", id: "phase" });
  const cards = make("div", { id: "cards" });
  const facts = make("dl", { className: "facts", id: "tiles" });
  const stage = make("div", { className: "stage" }), residuals = make("section", { className: "residuals" });
  const recent = make("ul", { className: "recent", id: "recent" });
  const progress = make("div", { className: "progress" }, whole.track, make("div", { className: "figures" }, percent, left), own.track, phase);
  const result = make("div", { id: "result-place" }), links = make("ul", { className: "links", id: "links" }), receivers = make("ul", { className: "links", id: "receivers" });
  const above = make("div", { className: "now" }, kind, words, progress);
  const side = make("section", { className: "side", tabIndex: 0 }, above, cards, facts, links, receivers, result, residuals, recent);
  view.replaceChildren(stage, side);
  const show = () => seen.status && render(seen.status, { side, kind, words, progress, whole, own, percent, left, phase, cards, facts, links, receivers });
  const showRecent = () => recent.replaceChildren(...seen.events.slice(0, RECENT).map(eventLine));
  on("status", () => {
    const run = seen.status?.unfinished ?? null;
    if (run !== kept.run) readKept(run).then(show);
    show();
  });
  on("event", showRecent);
  onLanguage(show);
  onLanguage(showRecent);
  openScene(stage);
  openResiduals(residuals);
  openResult(result);
}

function render(status, parts) {
  const now = doing(status);
  if (parts.words.textContent !== now) parts.words.textContent = now;
  parts.side.ariaLabel = say("operator.side");
  parts.kind.textContent = runText(status);
  parts.progress.hidden = AT_REST.has(status.state);
  const { fraction, minutes_left: left, phase_fraction: ofPhase } = status;
  /* The minutes of the run are not known before the end of the preflight. */
  parts.progress.classList.toggle("preflight", left === null && status.phase === "preflight");
  fill(parts.whole, fraction, say("progress.name"));
  fill(parts.own, ofPhase, say("progress.phase"));
  parts.percent.textContent = left === null ? "" : `${number(Math.round(100 * fraction), 0)} %`;
  parts.left.textContent = left === null ? "" : say("progress.left", { minutes: number(Math.ceil(left), 0) });
  parts.phase.textContent = phaseText(status);
  parts.facts.replaceChildren(...FACTS.map(([name, text]) => make("div", {}, make("dt", {}, say(name)), make("dd", {}, text(status)))));
  parts.links.ariaLabel = say("link.title");
  parts.links.replaceChildren(...status.links.map(linkMark));
  parts.receivers.ariaLabel = say("receiver.title");
  parts.receivers.replaceChildren(...status.receivers.filter(({ problem }) => problem).map(receiverMark));
  const cards = [
    ...(status.question ? [questionCard(status.question)] : []),
    ...(status.unproved ? [unprovedCard(status)] : []),
    ...alarmsBeside(status).map(alarmCard),
    ...(status.unfinished !== null && status.unproved === null && AT_REST.has(status.state) ? [unfinishedCard(status)] : []),
  ];
  const shown = JSON.stringify([status.question, status.unfinished, kept.balls, status.state, status.unproved, status.may, status.alarms, document.documentElement.lang]);
  if (parts.cards.dataset.shown === shown) return;
  parts.cards.dataset.shown = shown;
  parts.cards.replaceChildren(...cards);
  announce(status.alarms);
}

/* Alarms are read aloud in every view; the cards, whose buttons come and go, are not announced as a whole. */
function announce(alarms) {
  const text = alarms.map((alarm) => `${alarmTitle(alarm)}. ${told(alarm.text)}.`).join(" ");
  if (byId("alarms").textContent !== text) byId("alarms").textContent = text;
}

function progressBar(className) {
  const bar = make("div", { className: "done" });
  return { bar, track: make("div", { className, role: "progressbar" }, bar) };
}

/* A fraction that is not known shows as a moving bar without a value. */
function fill({ bar, track }, fraction, name) {
  const share = fraction === null ? null : Math.round(100 * fraction);
  track.setAttribute("aria-label", name);
  track.classList.toggle("unknown", share === null);
  bar.style.width = share === null ? "" : `${share}%`;
  if (share === null) track.removeAttribute("aria-valuenow");
  else track.setAttribute("aria-valuenow", share);
}

const eventLine = (event) => make("li", {}, make("time", { dateTime: event.at }, timeOfDay(event.at)), " ", eventText(event));

function questionCard({ number: asked, text, station, placement }) {
  const answer = (yes) => request("/api/answer", { number: asked, yes }, yes ? "done.yes" : "done.no");
  return make("section", { className: "card question" },
    make("h2", {}, questionTitle(station, placement)),
    ...(placement ? placementLines(placement) : [make("p", {}, told(text))]),
    make("div", { className: "actions" },
      make("button", { id: "answer-yes", className: "go", onclick: () => answer(true) }, say("question.yes")),
      make("button", { id: "answer-no", onclick: () => answer(false) }, say("question.no"))));
}

function questionTitle(station, placement) {
  if (station === null) return say("question.title");
  return say(placement ? "question.place" : "question.carry", { station });
}

function placementLines({ azimuth_deg: azimuth, elevation_deg: elevation, balls, refused, refused_ball: ball }) {
  const angle = (value) => number(value, Number.isInteger(value) ? 0 : 1);
  const reason = `refused.${refused}`;
  const place = ({ ball: which, position_mm: [x, y, z] }) =>
    make("li", {}, say("question.place.ball", { ball: which, x: number(x, 1), y: number(y, 1), z: number(z, 1) }));
  return [
    refused && known(reason) ? make("p", { className: "hint" }, say(reason, { ball: ball === null ? "" : ball })) : null,
    make("p", {}, say("question.place.pose", { azimuth: angle(azimuth), elevation: angle(elevation) })),
    make("ul", {}, ...balls.map(place)),
    make("p", {}, say("question.place.then", { ball: balls.length ? balls[0].ball : "" })),
  ];
}

/* Balls that an unfinished run has in the journal; null until the service has answered. */
const kept = { run: null, balls: null };

async function readKept(run) {
  Object.assign(kept, { run, balls: null });
  if (run === null) return;
  try {
    const { balls } = await read(`/api/runs/${run}`);
    if (kept.run === run) kept.balls = balls;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
  }
}

function unfinishedCard({ unfinished: run, may }) {
  const allowed = may.includes("give_up");
  const giveUp = async () => {
    const name = say("unfinished.give_up");
    if (await askConfirmation(name, say("unfinished.give_up.is"), name)) await request("/api/give-up-run", {}, "done.give_up_run");
  };
  return make("section", { className: "card waiting", id: "unfinished" },
    make("h2", {}, say("unfinished.title")), make("p", {}, say("unfinished.text", { run })),
    kept.balls === null ? null : make("p", {}, say("unfinished.balls", { balls: number(kept.balls, 0) })),
    make("p", { className: "hint" }, say(allowed ? "unfinished.do" : "unfinished.reset")),
    allowed ? make("button", { id: "give-up-run", onclick: giveUp }, say("unfinished.give_up")) : null);
}

/* Ways out of an unproved table in the order in which they are tried; each has its button once it is allowed. */
function unprovedCard({ unproved, may, alarms }) {
  const { run_id: run, bank, former_bank: former, provable, situation } = unproved;
  const reason = alarms.map(({ text }) => text).find((text) => text.startsWith(`${situation}: `))?.slice(situation.length + 2);
  const can = (what) => may.includes(what);
  const facts = { run, bank, former };
  const step = (text, id, label, act, allowed) => make("li", {}, say(text, facts), " ",
    make("button", { id, disabled: !allowed, onclick: act }, say(label, facts)));
  const post = (path, done) => () => request(`/api/${path}`, path === "resume-run" ? { source: "page" } : {}, done);
  return make("section", { className: "card alarm", id: "unproved" },
    make("h2", {}, say("unproved.title")),
    make("p", {}, say("unproved.situation", facts)),
    reason ? make("p", { className: "where" }, say("unproved.reason", { reason: told(reason) })) : null,
    can("restore_former") ? null : make("p", { className: "hint" }, say("unproved.reset_first")),
    make("ol", { className: "ways-out" },
      step(former ? "unproved.restore" : "unproved.restore_none", "restore-former", "unproved.restore.button",
        post("unproved-table/restore", "done.restore_former"), can("restore_former")),
      provable
        ? step("unproved.prove", "prove-table", "unproved.prove.button", post("resume-run", "done.resume_run"), can("resume_run"))
        : make("li", {}, say("unproved.not_provable", facts)),
      step(former ? "unproved.give_up" : "unproved.give_up_none", "give-up", "unproved.give_up.button",
        post("give-up-run", "done.give_up"), can("give_up"))));
}

/* The card of an unproved table says what its alarm says, with buttons in place of commands. */
const alarmsBeside = ({ alarms, unproved }) =>
  alarms.filter(({ text }) => !(unproved && text.startsWith(unproved.situation)));

function alarmTitle({ code }) {
  const title = `alarm.${code}`;
  return `${say("alarm.word")} ${code}${known(title) ? `: ${say(title)}` : ""}`;
}

function alarmCard({ code, text, hint, where }) {
  const own = `alarm.${code}.do`;
  const todo = known(own) ? say(own) : told(hint);
  const at = whereWords(where);
  return make("section", { className: "card alarm" },
    make("h2", {}, alarmTitle({ code })),
    make("p", {}, told(text)),
    make("p", { className: "hint" }, `${say("alarm.do")} ${todo}`),
    hint && !sameWords(hint, inEnglish(own)) ? make("p", {}, told(hint)) : null,
    at ? make("p", { className: "where" }, at) : null);
}

/* The general hint of the service equals that of the catalogue; only a more specific hint is shown in addition. */
const lettersOf = (text) => text.toLowerCase().replaceAll(/\W+/g, "");
const sameWords = (one, other) => lettersOf(one) === lettersOf(other);

/* What the controller was last seen to apply, with the age of that reading; never a guess. */
function bankText({ active_bank: bank, written_not_active: waiting, read_age_s: age, read_problem: problem }) {
  const known = bank === null ? say("bank.unknown") : bank === 0 ? say("bank.none") : say("bank.number", { bank });
  const words = waiting === null ? known : say("bank.waiting", { bank: waiting });
  return make("span", {}, words, age === null ? null : make("small", { className: "age", title: told(problem) }, ageText(age)));
}

const ageText = (age) => (age < MINUTE_S ? say("age.seconds", { seconds: number(Math.floor(age), 0) }) : say("age.minutes", { minutes: number(Math.floor(age / MINUTE_S), 0) }));

/* Channel of the notifications that delivers nothing or only in part: since when, why, and how many notices wait for it. */
function receiverMark({ channel, waiting, delivery, problem, since }) {
  const words = say(`receiver.${delivery}`, { channel: say(`receiver.${channel}`), since: instant(since), waiting: number(waiting, 0) });
  const mark = make("li", {}, make("span", { className: "shape", ariaHidden: "true" }), `${words}: ${told(problem)}`);
  mark.dataset.look = delivery === "partial" ? "held" : "fault";
  return mark;
}

function linkMark({ device, ok, problem, unread }) {
  const words = say(unread ? "link.unread" : ok ? "link.ok" : "link.lost");
  const mark = make("li", { title: told(unread || problem) || words }, make("span", { className: "shape", ariaHidden: "true" }), `${device}: ${words}`);
  mark.dataset.look = unread ? "quiet" : ok ? "done" : "fault";
  return mark;
}
