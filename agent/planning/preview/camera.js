/* Orthographic camera: lengths stay comparable and the plan views are to scale. Lengths in mm, angles in rad.
   It looks against `toEye`; yaw turns about Z, pitch raises the eye above the XY plane. */
const RIGHT_ANGLE = Math.PI / 2;
const VIEWS = {
  isometric: [-0.75 * Math.PI, Math.atan(Math.SQRT1_2)],
  xy: [-RIGHT_ANGLE, RIGHT_ANGLE],
  xz: [-RIGHT_ANGLE, 0],
  yz: [0, 0],
};

class Camera {
  constructor() {
    this.scale = 1;
    this.target = [0, 0, 0];
    this.width = this.height = 1;
    this.look("isometric");
  }

  look(name) {
    [this.yaw, this.pitch] = VIEWS[name];
    this.orient();
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(RIGHT_ANGLE, Math.max(-RIGHT_ANGLE, this.pitch + pitch));
    this.orient();
  }

  orient() {
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    this.right = [-sy, cy, 0];
    this.up = [-sp * cy, -sp * sy, cp];
    this.toEye = [cp * cy, cp * sy, sp];
  }

  /* Return screen x, y in CSS pixels and the depth in mm, larger when closer to the eye. */
  project(p) {
    const x = p[0] - this.target[0], y = p[1] - this.target[1], z = p[2] - this.target[2];
    const { right: r, up: u, toEye: e, scale } = this;
    return [
      this.width / 2 + scale * (r[0] * x + r[1] * y),
      this.height / 2 - scale * (u[0] * x + u[1] * y + u[2] * z),
      e[0] * x + e[1] * y + e[2] * z,
    ];
  }

  /* Shift the view by (dx, dy) pixels. */
  shift(dx, dy) {
    for (let i = 0; i < 3; i++) this.target[i] += (-dx * this.right[i] + dy * this.up[i]) / this.scale;
  }

  /* Zoom with the point under the pixel (x, y) fixed. */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const scale = Math.min(40, Math.max(0.01, this.scale * factor));
    const kept = 1 - scale / this.scale;
    const dx = (x - this.width / 2) * kept, dy = (y - this.height / 2) * kept;
    this.scale = scale;
    this.shift(dx, dy);
  }

  /* Fit all `points` into the view, up to a margin. */
  fit(points) {
    this.target = [0, 0, 0];
    this.scale = 1;
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (const point of points) {
      this.project(point).slice(0, 2).forEach((value, i) => {
        low[i] = Math.min(low[i], value);
        high[i] = Math.max(high[i], value);
      });
    }
    const middle = [(low[0] + high[0]) / 2 - this.width / 2, (low[1] + high[1]) / 2 - this.height / 2];
    for (let i = 0; i < 3; i++) this.target[i] = middle[0] * this.right[i] - middle[1] * this.up[i];
    const room = 0.9;
    this.scale = room * Math.min(this.width / (high[0] - low[0] + 1), this.height / (high[1] - low[1] + 1));
  }
}
