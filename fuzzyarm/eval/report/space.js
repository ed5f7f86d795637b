// Any serial robot, in perspective: with the eye e and unit vectors r (right), d (down) and a (ahead), a point p is seen
// at distance (dᵀ(p - e), rᵀ(p - e)) / aᵀ(p - e), in metres as they are seen at that distance.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, factor = 1) => a.map((value, axis) => value + factor * b[axis]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (matrix, vector) => matrix.map((row) => dot(row, vector));
const product = (a, b) => a.map((row) => [0, 1, 2].map((column) => dot(row, b.map((other) => other[column]))));

/** Return exp([u]× q), the rotation by an angle [rad] about a unit vector (Rodrigues). */
function turn([x, y, z], angle) {
  const s = Math.sin(angle), c = 1 - Math.cos(angle);
  return [
    [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
    [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
    [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)]];
}

const THICKNESS = 0.055, THINNEST = 0.6; // of the first link, share of the reach; of the last one, share of the first

const space = {
  /** Return the points [m] and the axes of joints at joint angles [rad]. */
  chain(angles) {
    let rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], origin = [0, 0, 0];
    const points = [origin], axes = [];
    report.robot.joints.forEach((joint, k) => {
      origin = plus(origin, times(rotation, joint.position));
      rotation = product(product(rotation, joint.rotation), turn(joint.axis, angles[k]));
      points.push(origin);
      axes.push(times(rotation, joint.axis));
    });
    return { points: [...points, plus(origin, times(rotation, report.robot.tip))], axes };
  },

  /** Return base, joints and tip [m]. */
  points: (angles) => space.chain(angles).points,

  within: (angles) => space.points(angles),

  depth: (point) => dot(report.robot.axes[2], plus(point, report.robot.eye, -1)),

  seen(point) {
    const [right, down, ahead] = times(report.robot.axes, plus(point, report.robot.eye, -1));
    return [(report.robot.distance * down) / ahead, (report.robot.distance * right) / ahead];
  },

  across(point, force) {
    const size = Math.hypot(...force) || 1, here = space.seen(point), back = space.seen(plus(point, force, -1e-3 / size));
    return [1, 0].map((axis) => (1e3 * size * (here[axis] - back[axis])));
  },

  below(point) {
    const { up, height } = report.robot.floor;
    return plus(point, up, height - dot(point, up));
  },

  ground(context, pixel, scale, path) {
    for (const line of report.robot.floor.grid) stroke(context, line.map(pixel), colours.line, 1);
    stroke(context, path.map((point) => pixel(space.below(point))), colours.line, 2);
  },

  shadow(context, pixel, scale, angles) {
    const points = space.points(angles).map((point) => pixel(space.below(point)));
    stroke(context, points, colours.line, 0.5 * THICKNESS * report.robot.reach * scale);
  },

  /** Draw links and joints, far ones first. */
  arm(context, pixel, scale, angles) {
    const { points, axes } = space.chain(angles), places = points.map(pixel), size = THICKNESS * report.robot.reach;
    const last = points.length - 1, depths = points.map(space.depth);
    const width = (k) => ((size * scale * report.robot.distance) / depths[k]) * (1 + ((THINNEST - 1) * k) / last);
    const round = (factor) => Array.from({ length: 40 }, (_, k) => (2 * Math.PI * k) / 40).map((angle) => {
      const side = cross(axes[0], Math.abs(axes[0][0]) < 0.6 ? [1, 0, 0] : [0, 1, 0]), up = cross(axes[0], side);
      const radius = factor / Math.hypot(...side);
      return pixel(plus(plus(points[0], side, radius * Math.cos(angle)), up, radius * Math.sin(angle)));
    });
    polygon(context, round(1.3 * size), colours.edge);
    const links = Array.from({ length: last }, (_, k) => k);
    links.sort((a, b) => depths[b] + depths[b + 1] - depths[a] - depths[a + 1]);
    for (const k of links) {
      const wide = 0.5 * (width(k) + width(k + 1));
      stroke(context, [places[k], places[k + 1]], colours.edge, wide + 3);
      stroke(context, [places[k], places[k + 1]], colours.steel, wide);
    }
    const order = axes.map((_, k) => k).sort((a, b) => depths[b + 1] - depths[a + 1]);
    for (const k of order) {
      const ends = [1, -1].map((sign) => plus(points[k + 1], axes[k], 0.6 * sign * size));
      const near = space.depth(ends[0]) < space.depth(ends[1]) ? ends[0] : ends[1];
      stroke(context, ends.map(pixel), colours.edge, 0.95 * width(k + 1));
      disc(context, pixel(near), 0.25 * width(k + 1), colours.paper);
    }
  },
};

const shape = report.robot ? space : plane;
