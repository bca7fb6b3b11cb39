/* The plan embedded in the page, converted to mm and s. */
const TENTH = 0.1, HUNDREDTH = 0.01;

function readPlan(text) {
  const raw = JSON.parse(text);
  const path = readPath(raw.path);
  const placings = raw.placings.map((placing) => readPlacing(placing, raw.names));
  const stations = [...new Set(placings.map((placing) => placing.station))].sort((a, b) => a - b);
  return {
    ...raw,
    path,
    placings,
    stations,
    travel: readBox(raw.travel),
    table: readBox(raw.table),
    probe: raw.probe.map(([name, ...numbers]) => ({ name, ...(numbers.length === 6 ? { box: readBox(numbers) } : readCapsule(numbers)) })),
    visits: raw.visits.map(([phase, placing, first, end, note]) => ({ phase, placing: placings[placing], first, end, note })),
    refusal: raw.refusal && { ...raw.refusal, tip: raw.refusal.tip.map((value) => value * TENTH) },
  };
}

/* Integer differences, summed before conversion to mm and s. */
function readPath({ steps, times, touches, balls }) {
  const tips = [], ends = [], ballAt = [], at = [0, 0, 0];
  let seconds = 0;
  times.forEach((step, i) => {
    for (let k = 0; k < 3; k++) at[k] += steps[3 * i + k];
    tips.push(at.map((value) => value * TENTH));
    ends.push((seconds += step) * HUNDREDTH);
  });
  for (const [ball, count] of balls) for (let i = 0; i < count; i++) ballAt.push(ball);
  return { tips, ends, ballAt, touches: [...touches].map((mark) => mark === "1") };
}

function readPlacing(raw, names) {
  const bodies = joined(raw.bodies.map(([index, ...numbers]) => ({ name: names[index], ...readCapsule(numbers) })));
  const radius = (number) => bodies.find((body) => body.name === `ball ${number}`).radius;
  const balls = raw.balls.map(([x, y, z, whyNot], number) => ({
    number, whyNot, centre: [x * TENTH, y * TENTH, z * TENTH], radius: radius(number),
  }));
  const carriers = bodies.filter((body) => !NOT_A_CARRIER.test(body.name));
  return { ...raw, bodies, balls, carriers: new Set(carriers) };
}

/* All other bodies carry the posts of the artefact: the bar, the plate or the rods of a frame. */
const NOT_A_CARRIER = /^(ball|post|shaft|pedestal)\b| at station \d+$/;

/* A bar consists of pieces from post to post; it is drawn as one. */
function joined(bodies) {
  const whole = [];
  for (const body of bodies) {
    const last = whole[whole.length - 1];
    if (last && last.name === body.name && distance(last.b, body.a) < 1) last.b = body.b;
    else whole.push(body);
  }
  return whole;
}

const readCapsule = (n) => ({ a: mm(n, 0), b: mm(n, 3), radius: n[6] * TENTH });
const readBox = (n) => ({ low: mm(n, 0), high: mm(n, 3) });
const mm = (numbers, from) => [0, 1, 2].map((i) => numbers[from + i] * TENTH);

/* Return the last touch of a visit, or its last waypoint if there is none. */
function restingPoint(plan, visit) {
  for (let i = visit.end - 1; i >= visit.first; i--) if (plan.path.touches[i]) return i;
  return Math.max(visit.end - 1, 0);
}

function restAt(plan, number) {
  const refused = plan.refusal && plan.refusal.visit === number;
  return refused ? Math.max(plan.visits[number].end - 1, 0) : restingPoint(plan, plan.visits[number]);
}

function phaseOf(visit) {
  if (visit.note) return visit.note;
  if (visit.phase === "probe") return "probe check and qualification of the stylus";
  if (visit.phase === "verify") return "held out, measured again with the new table";
  return visit.placing.heldOut ? "held out, measured before the new table" : "measured for the estimate";
}

function boxCorners({ low, high }) {
  const corners = [];
  for (let i = 0; i < 8; i++) corners.push([i & 1 ? high[0] : low[0], i & 2 ? high[1] : low[1], i & 4 ? high[2] : low[2]]);
  return corners;
}

const added = (p, q) => [p[0] + q[0], p[1] + q[1], p[2] + q[2]];
const between = (p, q, t) => [0, 1, 2].map((i) => p[i] + t * (q[i] - p[i]));
const distance = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
