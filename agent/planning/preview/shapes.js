/* Solid bodies on a 2D canvas: each is split into pieces with a depth, painted from far to near. */
const PIECE_MM = 100;

const BOX_FACES = [
  [0, -1, [0, 2, 6, 4]], [0, 1, [1, 3, 7, 5]], [1, -1, [0, 1, 5, 4]],
  [1, 1, [2, 3, 7, 6]], [2, -1, [0, 1, 3, 2]], [2, 1, [4, 5, 7, 6]],
];
const BOX_EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

function capsulePieces(camera, { a, b, radius }, colour) {
  const count = Math.max(1, Math.ceil(distance(a, b) / PIECE_MM));
  const width = Math.max(1.5, 2 * radius * camera.scale);
  const pieces = [a, b].map((end) => discPiece(camera, end, radius, colour, -0.5));
  for (let i = 0; i < count; i++) {
    const from = camera.project(between(a, b, i / count)), to = camera.project(between(a, b, (i + 1) / count));
    pieces.push({ depth: (from[2] + to[2]) / 2, paint: (ctx) => paintTube(ctx, from, to, width, colour) });
  }
  return pieces;
}

/* Lighter towards the upper left, as if lit from there. Pieces overlap by a pixel to hide seams. */
function paintTube(ctx, from, to, width, colour) {
  const length = Math.hypot(to[0] - from[0], to[1] - from[1]) || 1;
  const end = [to[0] + (to[0] - from[0]) / length, to[1] + (to[1] - from[1]) / length];
  ctx.lineCap = "butt";
  line(ctx, from, end, width, colour);
  if (width < 4) return;
  let nx = (to[1] - from[1]) / length, ny = -(to[0] - from[0]) / length;
  if (nx + ny > 0) [nx, ny] = [-nx, -ny];
  const off = ([x, y]) => [x + nx * width * 0.18, y + ny * width * 0.18];
  line(ctx, off(from), off(end), width * 0.34, `color-mix(in srgb, ${colour}, white 30%)`);
}

function line(ctx, from, to, width, colour) {
  ctx.lineWidth = width;
  ctx.strokeStyle = colour;
  ctx.beginPath();
  ctx.moveTo(from[0], from[1]);
  ctx.lineTo(to[0], to[1]);
  ctx.stroke();
}

function discPiece(camera, centre, radius, colour, nearer = 0) {
  const [x, y, depth] = camera.project(centre);
  const size = Math.max(0.75, radius * camera.scale);
  return { depth: depth + nearer, paint: (ctx) => disc(ctx, x, y, size, colour) };
}

function disc(ctx, x, y, size, colour) {
  ctx.fillStyle = colour;
  ctx.beginPath();
  ctx.arc(x, y, size, 0, 2 * Math.PI);
  ctx.fill();
}

function ballPiece(camera, centre, radius, colour) {
  const [x, y, depth] = camera.project(centre);
  const size = Math.max(2.5, radius * camera.scale);
  return {
    depth: depth + radius,
    paint: (ctx) => {
      disc(ctx, x, y, size, colour);
      if (size > 4) disc(ctx, x - 0.3 * size, y - 0.3 * size, 0.35 * size, "rgba(255,255,255,0.45)");
    },
  };
}

function ring(ctx, x, y, size, colour, width = 2) {
  ctx.lineWidth = width;
  ctx.strokeStyle = colour;
  ctx.beginPath();
  ctx.arc(x, y, size, 0, 2 * Math.PI);
  ctx.stroke();
}

/* Faces of a box towards the eye, translucent, so that bodies behind them stay visible. */
function boxPieces(camera, box, colour, opacity) {
  const corners = boxCorners(box).map((corner) => camera.project(corner));
  return BOX_FACES.filter(([axis, side]) => side * camera.toEye[axis] > 1e-6).map(([, , face]) => {
    const points = face.map((corner) => corners[corner]);
    const depth = points.reduce((sum, point) => sum + point[2] / 4, 0);
    return { depth, paint: (ctx) => polygon(ctx, points, colour, opacity) };
  });
}

function polygon(ctx, points, colour, opacity) {
  ctx.beginPath();
  points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.closePath();
  ctx.globalAlpha = opacity;
  ctx.fillStyle = colour;
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.lineWidth = 1;
  ctx.strokeStyle = colour;
  ctx.stroke();
}

function paintSorted(ctx, pieces) {
  pieces.sort((one, other) => one.depth - other.depth);
  for (const piece of pieces) piece.paint(ctx);
}
