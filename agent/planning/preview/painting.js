/* Paint the plan: workspace, other positions, path, and in front the selected position. */
const NEAR_PX = 2;

/* Return the screen position of every ball, for the pointer. `state.tip` puts the probe elsewhere than at the waypoint
   `state.progress`; `state.ahead` shows the rest of the path in this position. */
function paint(ctx, camera, plan, state, colours) {
  ctx.clearRect(0, 0, camera.width, camera.height);
  const visit = plan.visits[state.visit];
  paintWorkspace(ctx, camera, plan, colours);
  for (const station of plan.stations) if (station !== visit.placing.station) paintPedestal(ctx, camera, plan, station, colours);
  const others = state.others ? plan.placings.filter((placing) => placing !== visit.placing) : [];
  for (const placing of others) paintGhost(ctx, camera, placing, colours);
  if (state.path) paintPath(ctx, camera, plan.path.tips, 0, Math.min(visit.first, state.progress), colours.path, 0.3);
  if (state.ahead && !visit.note) paintAhead(ctx, camera, plan.path.tips, state, visit.end - 1, colours);
  const pieces = standingPieces(camera, plan, visit.placing, colours);
  if (state.path && !visit.note) pieces.push(...pathPieces(camera, plan.path.tips, visit.first, state.progress, colours));
  if (state.probe && !visit.note) pieces.push(...probePieces(camera, plan, state.tip ?? plan.path.tips[state.progress], state.visit, colours));
  paintSorted(ctx, pieces);
  const seen = [...others, visit.placing].flatMap((placing) => ballsOnScreen(camera, placing));
  for (const { x, y, size, ball } of seen) if (ball.whyNot) ring(ctx, x, y, Math.max(3.5, size), colours.red);
  if (plan.refusal && plan.refusal.visit === state.visit) paintMeeting(ctx, camera, plan.refusal.tip, colours);
  paintStations(ctx, camera, plan, visit.placing.station, colours);
  return seen;
}

function paintWorkspace(ctx, camera, plan, colours) {
  paintSorted(ctx, boxPieces(camera, tableTop(plan.table), colours.table, 0.22));
  const corners = boxCorners(plan.travel).map((corner) => camera.project(corner));
  ctx.setLineDash([5, 4]);
  for (const [from, to] of BOX_EDGES) line(ctx, corners[from], corners[to], 1, colours.quiet);
  ctx.setLineDash([]);
  const { low, high } = plan.travel;
  ctx.font = "600 13px system-ui, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ["X", "Y", "Z"].forEach((name, axis) => {
    const end = low.map((value, i) => (i === axis ? high[i] : value));
    const from = camera.project(low), to = camera.project(end);
    const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
    if (length < 20) return;
    line(ctx, from, to, 1.6, colours.ink);
    ctx.fillStyle = colours.ink;
    ctx.fillText(name, to[0] + (14 * (to[0] - from[0])) / length, to[1] + (14 * (to[1] - from[1])) / length);
  });
}

/* A thin slab: the full thickness of the table would only hide other bodies. */
const tableTop = ({ low, high }) => ({ low: [low[0], low[1], high[2] - 40], high });

function paintGhost(ctx, camera, placing, colours) {
  const colour = colours.station(placing.station);
  ctx.lineCap = "round";
  ctx.globalAlpha = 0.35;
  for (const { a, b, radius } of placing.carriers) {
    line(ctx, camera.project(a), camera.project(b), Math.max(1.2, radius * camera.scale), colour);
  }
  ctx.globalAlpha = 0.55;
  for (const { x, y, size, ball } of ballsOnScreen(camera, placing)) {
    if (!ball.whyNot) disc(ctx, x, y, Math.max(1.8, size * 0.9), colour);
  }
  ctx.globalAlpha = 1;
}

/* Skip waypoints within a few pixels of the previous one: from afar a ball's touches are one dot. */
function paintPath(ctx, camera, tips, first, last, colour, opacity) {
  if (last <= first) return;
  ctx.globalAlpha = opacity;
  ctx.lineWidth = 1;
  ctx.strokeStyle = colour;
  ctx.lineJoin = "round";
  ctx.beginPath();
  let [x, y] = camera.project(tips[first]);
  ctx.moveTo(x, y);
  for (let i = first + 1; i <= last; i++) {
    const [u, v] = camera.project(tips[i]);
    if (Math.abs(u - x) + Math.abs(v - y) < NEAR_PX) continue;
    ctx.lineTo(u, v);
    [x, y] = [u, v];
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
}

/* From the tip to the last waypoint of the visit. */
function paintAhead(ctx, camera, tips, { progress, tip }, last, colours) {
  if (last <= progress) return;
  ctx.setLineDash([6, 5]);
  if (tip) line(ctx, camera.project(tip), camera.project(tips[progress + 1]), 1, colours.pathNow);
  paintPath(ctx, camera, tips, progress + 1, last, colours.pathNow, 0.85);
  ctx.setLineDash([]);
}

function pathPieces(camera, tips, first, last, colours) {
  const pieces = [];
  let from = tips.length ? camera.project(tips[Math.max(first - 1, 0)]) : null;
  for (let i = first; i <= Math.min(last, tips.length - 1); i++) {
    const start = from, to = camera.project(tips[i]);
    const paintIt = (ctx) => {
      ctx.lineCap = "round";
      line(ctx, start, to, 1.6, colours.pathNow);
    };
    pieces.push({ depth: (start[2] + to[2]) / 2, paint: paintIt });
    from = to;
  }
  return pieces;
}

function standingPieces(camera, plan, placing, colours) {
  const hit = plan.refusal && plan.visits[plan.refusal.visit].placing === placing ? plan.refusal.bodies : [];
  const unreached = new Set(placing.balls.filter((ball) => ball.whyNot).map((ball) => `ball ${ball.number}`));
  return placing.bodies.flatMap((body) => {
    if (body.name.startsWith("ball ")) {
      if (unreached.has(body.name)) return hit.includes(body.name) ? [ballPiece(camera, body.a, body.radius, colours.red)] : [];
      return [ballPiece(camera, body.a, body.radius, hit.includes(body.name) ? colours.red : colours.station(placing.station))];
    }
    const own = placing.carriers.has(body) ? colours.station(placing.station) : colours.steel;
    return capsulePieces(camera, body, hit.includes(body.name) ? colours.red : own);
  });
}

function probePieces(camera, plan, tip, visit, colours) {
  const hit = plan.refusal && plan.refusal.visit === visit ? plan.refusal.bodies : [];
  const pieces = plan.probe.flatMap((body) => {
    const colour = hit.includes(body.name) ? colours.red : body.box ? colours.ram : colours.probe;
    if (body.box) {
      const box = { low: added(body.box.low, tip), high: added(body.box.high, tip) };
      return boxPieces(camera, box, colour, 0.3);
    }
    return capsulePieces(camera, { a: added(body.a, tip), b: added(body.b, tip), radius: body.radius }, colour);
  });
  return [...pieces, ballPiece(camera, tip, plan.probe[0].radius, hit.includes("tip") ? colours.red : colours.ink)];
}

function paintMeeting(ctx, camera, tip, colours) {
  const [x, y] = camera.project(tip);
  ring(ctx, x, y, 14, colours.red, 2.5);
  ring(ctx, x, y, 20, colours.red, 1);
}

function pedestalAt(plan, station) {
  return plan.placings.find((placing) => placing.station === station).bodies.find((body) => body.name === "pedestal");
}

/* Pedestal of another station. */
function paintPedestal(ctx, camera, plan, station, colours) {
  const { a, b, radius } = pedestalAt(plan, station);
  ctx.lineCap = "butt";
  ctx.globalAlpha = 0.3;
  line(ctx, camera.project(a), camera.project(b), Math.max(2, 2 * radius * camera.scale), colours.steel);
  ctx.globalAlpha = 1;
}

/* The selected station is painted last, above those behind it. */
function paintStations(ctx, camera, plan, current, colours) {
  ctx.font = "600 12px system-ui, sans-serif";
  for (const station of [...plan.stations.filter((number) => number !== current), current]) {
    const [x, y] = camera.project(pedestalAt(plan, station).a);
    disc(ctx, x, y, 10, colours.paper);
    ring(ctx, x, y, 10, colours.station(station));
    ctx.fillStyle = colours.ink;
    ctx.fillText(String(station), x, y + 0.5);
  }
}

function ballsOnScreen(camera, placing) {
  return placing.balls.map((ball) => {
    const [x, y, depth] = camera.project(ball.centre);
    return { x, y, depth, size: ball.radius * camera.scale, ball, placing };
  });
}
