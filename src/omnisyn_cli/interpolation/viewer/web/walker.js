// Somebody who walks: how far along the way, how far beside it, which way they look.

const REACH = 0.5; // of the distance between neighbours: how far beside the way one can go
const SPEED = 1.2; // metres a second
const FIELD = { least: 0.35, usual: 1.15, most: 2.0 }; // radians from top to bottom

class Walker {
  constructor(world) {
    this.world = world;
    Object.assign(this, { s: 0, beside: [0, 0, 0], fov: FIELD.usual, isPlaying: false, goal: null, attitude: null });
    const way = world.along(0);
    const ahead = way && Math.hypot(way[0], way[2]) > 0.2 ? way : rotated(world.panoramas[0].rotation, [0, 0, -1]);
    Object.assign(this, { yaw: lookOfDirection(ahead).yaw, pitch: 0 });
  }

  get position() {
    return add(this.world.pointAt(this.s), this.beside);
  }

  // What the device's sensors say, else what was dragged.
  get rotation() {
    const look = rotationOfLook(this.yaw, this.attitude ? 0 : this.pitch);
    return this.attitude ? product(look, this.attitude) : look;
  }

  get reach() {
    return Math.max(REACH * this.world.lengths[this.world.pairAt(this.s).pair], 0.05);
  }

  // From 0 on the way to 1 as far beside it as one can go.
  get strangeness() {
    const share = length(this.beside) / this.reach;
    return clamp((share - 0.3) / 0.7, 0, 1);
  }

  turn(right, up) {
    this.hasMoved = true;
    this.yaw += right;
    this.pitch = clamp(this.pitch + up, -Math.PI / 2, Math.PI / 2);
  }

  zoom(factor) {
    this.hasMoved = true;
    this.fov = clamp(this.fov * factor, FIELD.least, FIELD.most);
  }

  // Along the way, by so many metres; panoramas at one place are a metre apart then.
  walk(metres) {
    this.hasMoved = true;
    let rest = metres;
    while (rest !== 0) {
      const { pair } = this.world.pairAt(rest < 0 ? Math.ceil(this.s) - 1 : this.s);
      const unit = this.world.lengths[pair] > STILL ? this.world.lengths[pair] : 1;
      const aim = clamp(this.s + rest / unit, pair, pair + 1);
      if (aim === this.s) break;
      rest -= (aim - this.s) * unit;
      if (Math.abs(rest) < 1e-9) rest = 0;
      this.s = aim;
    }
    this.beside = times(this.beside, Math.exp(-Math.abs(metres - rest) / Math.max(this.reach, 1e-3)));
  }

  // In the frame of who looks: to the right, up (of the world), ahead on the level.
  step(right, up, ahead) {
    const { yaw } = lookOfDirection(rotated(this.rotation, [0, 0, -1]));
    const move = [right * Math.cos(yaw) + ahead * Math.sin(yaw), up, right * Math.sin(yaw) - ahead * Math.cos(yaw)];
    const way = this.world.along(this.world.pairAt(this.s).pair);
    const share = way ? dot(move, way) : ahead;
    if (Math.abs(share) > 1e-9) this.walk(share);
    if (way) this.beside = add(this.beside, minus(move, times(way, share)));
    const far = length(this.beside);
    if (far > this.reach) this.beside = times(this.beside, this.reach / far);
  }

  // Which end of the way one looks at: 1 the last, −1 the first.
  get sense() {
    const way = this.world.along(this.world.pairAt(this.s).pair);
    return way && dot(rotated(this.rotation, [0, 0, -1]), way) < 0 ? -1 : 1;
  }

  goTo(s, isSudden) {
    this.isPlaying = false;
    this.goal = clamp(s, 0, this.world.last);
    if (isSudden) {
      Object.assign(this, { s: this.goal, beside: [0, 0, 0], goal: null });
    }
  }

  play() {
    if (this.s >= this.world.last) this.s = 0;
    Object.assign(this, { isPlaying: true, goal: null });
  }

  // Whether anything moved in so many seconds.
  advance(seconds) {
    if (this.goal !== null) {
      const before = this.s;
      this.walk(Math.sign(this.goal - this.s) * SPEED * 1.5 * seconds);
      if ((this.goal - before) * (this.goal - this.s) <= 0) Object.assign(this, { s: this.goal, beside: [0, 0, 0], goal: null });
      return true;
    }
    if (!this.isPlaying) return false;
    this.walk(SPEED * seconds);
    if (this.s >= this.world.last) this.isPlaying = false;
    return true;
  }

  // The place as it stands in the address of the page.
  get address() {
    const degrees = (angle) => (angle * 180 / Math.PI).toFixed(1);
    const turned = Math.atan2(Math.sin(this.yaw), Math.cos(this.yaw));
    const place = `#t=${this.s.toFixed(3)}&yaw=${degrees(turned)}&pitch=${degrees(this.pitch)}&fov=${degrees(this.fov)}`;
    return length(this.beside) > 1e-3 ? `${place}&beside=${this.beside.map((x) => x.toFixed(3)).join(',')}` : place;
  }

  set address(hash) {
    const given = new URLSearchParams(hash.replace(/^#/, ''));
    const number = (name, unit, least, most) => {
      const value = given.has(name) ? Number(given.get(name)) * unit : NaN;
      return Number.isFinite(value) ? clamp(value, least, most) : null;
    };
    const degree = Math.PI / 180;
    this.s = number('t', 1, 0, this.world.last) ?? this.s;
    this.yaw = number('yaw', degree, -10, 10) ?? this.yaw;
    this.pitch = number('pitch', degree, -Math.PI / 2, Math.PI / 2) ?? this.pitch;
    this.fov = number('fov', degree, FIELD.least, FIELD.most) ?? this.fov;
    const beside = (given.get('beside') ?? '').split(',').map(Number);
    const isGiven = beside.length === 3 && beside.every(Number.isFinite);
    this.beside = isGiven ? times(beside, Math.min(1, this.reach / Math.max(length(beside), 1e-9))) : [0, 0, 0];
  }
}
