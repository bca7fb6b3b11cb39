/* Rotation and zoom of a view: one finger or the mouse rotates, two fingers zoom and pan; wheel and keys do the same. */
const TURN_PER_PX = 0.008, TURN_PER_KEY = 0.1, ZOOM_PER_KEY = 1.2, WHEEL = 500;

export function listenTo(canvas, camera, changed) {
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, at(event));
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const former = fingers.get(event.pointerId);
    if (!former) return;
    const before = [...fingers.values()];
    fingers.set(event.pointerId, at(event));
    if (fingers.size === 1) turn(camera, former, at(event));
    else if (fingers.size === 2) pinch(camera, before, [...fingers.values()]);
    changed();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(-event.deltaY / WHEEL), event.offsetX, event.offsetY);
    changed();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const act = KEYS[event.key];
    if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    act(camera);
    changed();
  });
}

const KEYS = {
  ArrowLeft: (camera) => camera.turn(TURN_PER_KEY, 0),
  ArrowRight: (camera) => camera.turn(-TURN_PER_KEY, 0),
  ArrowUp: (camera) => camera.turn(0, TURN_PER_KEY),
  ArrowDown: (camera) => camera.turn(0, -TURN_PER_KEY),
  "+": (camera) => camera.zoom(ZOOM_PER_KEY),
  "-": (camera) => camera.zoom(1 / ZOOM_PER_KEY),
};

const at = ({ offsetX, offsetY }) => [offsetX, offsetY];

function turn(camera, [x, y], [u, v]) {
  camera.turn(-(u - x) * TURN_PER_PX, (v - y) * TURN_PER_PX);
}

function pinch(camera, [a, b], [c, d]) {
  const [fromX, fromY] = middle(a, b), [toX, toY] = middle(c, d);
  camera.shift(toX - fromX, toY - fromY);
  camera.zoom(Math.hypot(d[0] - c[0], d[1] - c[1]) / Math.max(Math.hypot(b[0] - a[0], b[1] - a[1]), 1), toX, toY);
}

const middle = (p, q) => [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
