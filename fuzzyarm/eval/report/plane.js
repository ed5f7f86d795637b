// The two-joint arm, in its plane. Gravity points down: x of the robot's frame is drawn downwards, y to the right.
// `plane` and `space` have the same functions: places [m] of an arm, where they are seen, and how it is drawn there.

const plane = {
  /** Return base, elbow and tip [m] at joint angles [rad]. */
  points([q1, q2]) {
    const [length1, length2] = report.length;
    const elbow = [length1 * Math.cos(q1), length1 * Math.sin(q1)];
    return [[0, 0], elbow, [elbow[0] + length2 * Math.cos(q1 + q2), elbow[1] + length2 * Math.sin(q1 + q2)]];
  },

  /** Return the points that have to be in the picture, beside base and reference. */
  within: (angles) => plane.points(angles).slice(1, 2),

  /** Return where a point is seen, [down, right] in m. */
  seen: (point) => point,

  /** Return what is seen of a force at a point, [right, down] in N. */
  across: (_, [down, right]) => [right, down],

  /** Draw what lies below the arm and its path: all that the arm can reach. */
  ground(context, pixel, scale) {
    disc(context, pixel([0, 0]), scale * (report.length[0] + report.length[1]), colours.reach);
  },

  shadow() {},

  arm(context, pixel, scale, angles) {
    const thickness = 0.03 * scale * (report.length[0] + report.length[1]), links = plane.points(angles).map(pixel);
    drawMounting(context, links[0], thickness);
    for (const [start, end, share] of [[0, 1, 1], [1, 2, 0.75]]) {
      stroke(context, [links[start], links[end]], colours.edge, share * thickness + 3);
      stroke(context, [links[start], links[end]], colours.steel, share * thickness);
    }
    for (const joint of [0, 1]) {
      disc(context, links[joint], 0.6 * thickness, colours.edge);
      disc(context, links[joint], 0.27 * thickness, colours.paper);
    }
  },
};

function drawMounting(context, [right, down], thickness) {
  const at = ([x, y]) => [right + x * thickness, down + y * thickness];
  polygon(context, [[-0.6, 0], [-1.1, -1.7], [1.1, -1.7], [0.6, 0]].map(at), colours.edge);
  stroke(context, [[-1.8, -1.7], [1.8, -1.7]].map(at), colours.edge, 3);
}
