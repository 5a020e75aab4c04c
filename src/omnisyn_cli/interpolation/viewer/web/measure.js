// Distances between two points that are picked in the picture, and heights above the floor, each with its error: see
// docs/view.md. Points stay where they are in the world, so the second one can be picked from somewhere else.

const SHOWN_STDS = 2; // of the errors that are shown
const NEAREST = 0.05; // metres before the eye where lines are cut off

class Measure {
  // `lookUp` gives what is seen at a pixel: `{point, panorama, std}` or null, see OmnisynWalk.pointAt.
  constructor(root, world, lookUp) {
    Object.assign(this, { world, lookUp, isOn: false, points: [] });
    for (const id of ['measure', 'measured', 'ruler', 'cross']) this[id] = root.getElementById(id);
    this.stage = root.getElementById('stage');
    [this.line, this.label] = ['line', 'text'].map((name) => this.ruler.querySelector(name));
    this.ends = [...this.ruler.querySelectorAll('circle')];
  }

  // Says with its button why nothing can be measured.
  forbid(reason) {
    this.reason = reason;
    this.measure.setAttribute('aria-disabled', 'true');
    this.measure.title = `Measure: off, ${reason}`;
  }

  toggle(isOn = !this.isOn) {
    this.isOn = isOn && !this.reason;
    this.points = [];
    this.measure.setAttribute('aria-pressed', this.isOn);
    this.stage.toggleAttribute('data-measures', this.isOn);
    for (const part of [this.cross, this.ruler]) part.toggleAttribute('hidden', !this.isOn);
    this.measured.hidden = !this.isOn && !(isOn && this.reason);
    this.say(this.reason ? `Nothing can be measured here, ${this.reason}.` : 'Pick a point: click or tap it, or aim the cross at it and press Enter.');
    if (this.isOn) this.stage.focus(); // so that Enter does not press the button again
  }

  say(words) {
    this.measured.textContent = words;
  }

  // Forgets the points; without any it ends.
  clear() {
    this.toggle(this.points.length > 0);
  }

  pick(x, y) {
    const found = this.lookUp(x, y);
    if (found === undefined) return this.say('Surfaces are still being unpacked. Pick again.');
    if (!found) return this.say('--: no depth is known there (sky, a masked part, or too far to tell). Pick another point.');
    this.points = this.points.length === 2 ? [found] : [...this.points, found];
    return this.say(this.points.length === 2 ? this.distance.words : `Height above the floor: ${this.heightOf(found)}. Pick a second point for the distance.`);
  }

  get distance() {
    const [a, b] = this.points, between = minus(b.point, a.point), metres = length(between);
    const along = metres > 0 ? times(between, 1 / metres) : [0, 1, 0];
    const error = SHOWN_STDS * Math.hypot(stdAlong(a, along), stdAlong(b, along));
    const words = `Distance: ${inMetres(metres, error)}. Heights above the floor: ${this.heightOf(a)}, ${this.heightOf(b)}.`;
    return { metres, error, words };
  }

  // Above the floor of the nearest panorama; `--` where that is not seen.
  heightOf({ point, away, std }) {
    const { position, eyeHeight, floorError, index } = this.world.panoramas.reduce((a, b) => (
      length(minus(b.position, point)) < length(minus(a.position, point)) ? b : a));
    if (floorError === null) return '--';
    const floor = Math.hypot(floorError, eyeHeight ** 2 * this.world.inverseDepthStd(index, [0, -1, 0], 1));
    const error = SHOWN_STDS * Math.hypot(stdAlong({ away, std }, [0, 1, 0]), floor);
    return Number.isFinite(error) ? inMetres(point[1] - position[1] + eyeHeight, error) : '--';
  }

  show(walker, lens, [width, height]) {
    if (!this.isOn) return;
    const seen = this.points.map(({ point }) => unrotated(walker.rotation, minus(point, walker.position)));
    const at = ([x, y, z]) => [(lens[0] * x / -z + 1) * width / 2, (1 - lens[1] * y / -z) * height / 2];
    const isAhead = ([, , z]) => z < -NEAREST;
    this.ends.forEach((end, k) => {
      const isShown = Boolean(seen[k] && isAhead(seen[k]));
      end.toggleAttribute('hidden', !isShown);
      if (isShown) ['cx', 'cy'].forEach((name, axis) => end.setAttribute(name, at(seen[k])[axis]));
    });
    const isLine = seen.length === 2 && seen.some(isAhead);
    for (const part of [this.line, this.label]) part.toggleAttribute('hidden', !isLine);
    if (!isLine) return;
    const [from, to] = seen.map((end, k) => at(isAhead(end) ? end : beforeEye(seen[1 - k], end)));
    ['x1', 'y1', 'x2', 'y2'].forEach((name, k) => this.line.setAttribute(name, [...from, ...to][k]));
    ['x', 'y'].forEach((name, axis) => this.label.setAttribute(name, (from[axis] + to[axis]) / 2 - 8 * axis));
    const { metres, error } = this.distance;
    this.label.textContent = inMetres(metres, error);
  }
}

// Of a point in a direction of the world: large along the ray that it was measured on, small across.
function stdAlong({ away, std: [deep, across] }, direction) {
  const share = dot(away, direction) ** 2;
  return Math.sqrt(share * deep ** 2 + Math.max(1 - share, 0) * across ** 2);
}

// Where a line from a point ahead to one behind is cut off.
function beforeEye(ahead, behind) {
  return mixed(ahead, behind, (ahead[2] + NEAREST) / (ahead[2] - behind[2]));
}

// With no more digits than the error allows, which is rounded up.
function inMetres(metres, error) {
  const digits = error < 0.5 ? 2 : error < 5 ? 1 : 0;
  return `${metres.toFixed(digits)} m ± ${(Math.ceil(error * 10 ** digits - 1e-9) / 10 ** digits).toFixed(digits)} m`;
}
