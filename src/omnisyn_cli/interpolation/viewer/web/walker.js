// Somebody who walks: on which link, how far along it, how far beside it, which way they look.

const REACH = 0.5; // of the length of a link: how far beside it one can go
const SPEED = 1.2; // metres a second
const MIN_AHEAD = 0.1; // cosine of the angle to a link up to which it leads that way
const FIELD = { least: 0.35, usual: 1.15, most: 2.0 }; // radians from top to bottom

// Where a look leads: mostly on the level, so that whoever looks at the ground walks on; up and down where ways do.
function headingOf(direction) {
  const { yaw } = lookOfDirection(direction);
  const heading = add([Math.sin(yaw), 0, -Math.cos(yaw)], times(direction, 0.5));
  return times(heading, 1 / length(heading));
}

class Walker {
  constructor(world) {
    this.world = world;
    Object.assign(this, { beside: [0, 0, 0], fov: FIELD.usual, isPlaying: false, goal: null, path: [], passed: [], attitude: null, pitch: 0 });
    const { panorama, direction, fov } = world.walk.start;
    this.stand(panorama);
    const start = world.panoramas[panorama], way = start.links[0].way;
    const ahead = way && Math.hypot(way[0], way[2]) > 0.2 ? times(way, start.links[0].ends[0] === panorama ? 1 : -1)
      : rotated(start.rotation, [0, 0, -1]);
    this.yaw = lookOfDirection(ahead).yaw;
    if (direction) Object.assign(this, lookOfDirection(direction));
    if (fov) this.fov = clamp(fov * Math.PI / 180, FIELD.least, FIELD.most);
  }

  // At a panorama: the links of a chain are left at its start, as far as there is a next one.
  stand(panorama) {
    const { links } = this.world.panoramas[panorama];
    this.link = links.find((link) => link.ends[0] === panorama) ?? links[0];
    this.t = this.link.ends[0] === panorama ? 0 : 1;
    this.passed.push(panorama);
  }

  // How far along a chain: panorama k is at k.
  get s() {
    return this.link.index + this.t;
  }

  set s(value) {
    const { links } = this.world;
    this.link = links[clamp(Math.floor(value), 0, links.length - 1)];
    this.t = clamp(value - this.link.index, 0, 1);
  }

  // The panorama that one stands in, or null.
  get panorama() {
    return this.t === 0 || this.t === 1 ? this.link.ends[this.t] : null;
  }

  get nearest() {
    return this.link.ends[Math.round(this.t)];
  }

  // The panorama that one is on the way to, or null.
  get next() {
    return this.goal !== null || this.isPlaying ? this.path.find((k) => k !== this.panorama) ?? null : null;
  }

  get position() {
    return add(this.world.pointAt(this), this.beside);
  }

  // What the device's sensors say, else what was dragged.
  get rotation() {
    const look = rotationOfLook(this.yaw, this.attitude ? 0 : this.pitch);
    return this.attitude ? product(look, this.attitude) : look;
  }

  get ahead() {
    return rotated(this.rotation, [0, 0, -1]);
  }

  get speed() {
    return SPEED;
  }

  get reach() {
    return Math.max(REACH * this.link.metres, 0.05);
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

  // Which link leads closest to a direction, and whether to its second end (1) or its first (−1); null where none does.
  // `sign` decides where panoramas stand at one place, which has no direction.
  wayOut(direction, sign = 1) {
    const here = this.panorama;
    if (here === null) {
      return { link: this.link, sense: this.link.way ? Math.sign(dot(direction, this.link.way)) || 1 : sign };
    }
    const ways = this.world.panoramas[here].links.map((link) => {
      const sense = link.ends[0] === here ? 1 : -1;
      return { link, sense, share: link.way ? sense * dot(direction, link.way) : sense === sign ? 2 * MIN_AHEAD : -1 };
    });
    const best = ways.reduce((a, b) => (b.share > a.share ? b : a));
    return best.share > MIN_AHEAD * length(direction) ? best : null;
  }

  // By so many metres along a link; those that are left beyond its end.
  follow({ link, sense }, metres) {
    const here = this.panorama;
    const t = here === null ? this.t : link.ends[0] === here ? 0 : 1;
    const unit = this.world.lengthOf(link), left = (sense > 0 ? 1 - t : t) * unit;
    const isThere = metres >= left - 1e-9;
    Object.assign(this, { link, t: isThere ? (sense > 0 ? 1 : 0) : t + sense * metres / unit });
    this.beside = times(this.beside, Math.exp(-Math.min(metres, left) / Math.max(this.reach, 1e-3)));
    if (!isThere) return 0;
    this.passed.push(link.ends[sense > 0 ? 1 : 0]);
    return metres - left;
  }

  // Ahead by so many metres, or back by negative ones; at every crossing the way that one looks at.
  walk(metres, direction = times(headingOf(this.ahead), Math.sign(metres)), sign = Math.sign(metres)) {
    this.hasMoved = true;
    for (let rest = Math.abs(metres), k = 0; rest > 1e-9 && k < 100; k++) {
      const way = this.wayOut(direction, sign);
      if (!way) return;
      rest = this.follow(way, rest);
    }
  }

  // In the frame of who looks: to the right, up (of the world), ahead on the level.
  step(right, up, ahead) {
    const { yaw } = lookOfDirection(this.ahead);
    const move = [right * Math.cos(yaw) + ahead * Math.sin(yaw), up, right * Math.sin(yaw) - ahead * Math.cos(yaw)];
    const sign = Math.sign(ahead) || 1, way = this.wayOut(move, sign);
    const along = way?.link.way ? times(way.link.way, way.sense) : null;
    const share = along ? dot(move, along) : way ? Math.abs(ahead) : 0;
    if (share > 1e-9) this.walk(share, move, sign);
    if (along) this.beside = add(this.beside, minus(move, times(along, share)));
    else if (!way) this.beside = add(this.beside, this.across(move));
    const far = length(this.beside);
    if (far > this.reach) this.beside = times(this.beside, this.reach / far);
  }

  // What of a move does not lead along the link that ends here.
  across(move) {
    return this.link.way ? minus(move, times(this.link.way, dot(move, this.link.way))) : move;
  }

  // Along the shortest way to a panorama; at once where no links lead there.
  goTo(panorama, isSudden) {
    const path = this.world.pathTo(this, panorama);
    Object.assign(this, { isPlaying: false, goal: panorama, path });
    if (isSudden || !path.length) this.arrive(panorama);
  }

  arrive(panorama) {
    this.stand(panorama);
    Object.assign(this, { beside: [0, 0, 0], goal: null, path: [] });
  }

  play() {
    if (this.world.isChain && this.s >= this.world.last) this.s = 0;
    Object.assign(this, { isPlaying: true, goal: null, path: this.world.pathThroughAll(this) });
  }

  stop() {
    Object.assign(this, { isPlaying: false, goal: null, path: [] });
  }

  // Whether anything moved in so many seconds.
  advance(seconds) {
    if (this.goal === null && !this.isPlaying) return false;
    this.hasMoved = true;
    let rest = (this.isPlaying ? SPEED : 1.5 * SPEED) * seconds;
    while (this.path.length) {
      const next = this.path[0], here = this.panorama;
      if (here === next) {
        this.path.shift();
        continue;
      }
      if (rest <= 0) break;
      const link = here === null ? this.link : this.world.panoramas[here].links.find((one) => one.ends.includes(next));
      rest = this.follow({ link, sense: link.ends[1] === next ? 1 : -1 }, rest);
    }
    if (!this.path.length && this.goal !== null) this.arrive(this.goal);
    else if (!this.path.length) this.isPlaying = false;
    return true;
  }

  // The place as it stands in the address of the page.
  get address() {
    const degrees = (angle) => (angle * 180 / Math.PI).toFixed(1);
    const turned = Math.atan2(Math.sin(this.yaw), Math.cos(this.yaw));
    const names = this.link.ends.map((end) => encodeURIComponent(this.world.panoramas[end].name));
    const where = this.world.isChain ? `t=${this.s.toFixed(3)}`
      : this.panorama !== null ? `at=${names[this.t]}` : `from=${names[0]}&to=${names[1]}&t=${this.t.toFixed(3)}`;
    const place = `#${where}&yaw=${degrees(turned)}&pitch=${degrees(this.pitch)}&fov=${degrees(this.fov)}`;
    return length(this.beside) > 1e-3 ? `${place}&beside=${this.beside.map((x) => x.toFixed(3)).join(',')}` : place;
  }

  set address(hash) {
    const given = new URLSearchParams(hash.replace(/^#/, ''));
    const number = (name, unit, least, most) => {
      const value = given.has(name) ? Number(given.get(name)) * unit : NaN;
      return Number.isFinite(value) ? clamp(value, least, most) : null;
    };
    const degree = Math.PI / 180;
    this.goToAddress(given, number);
    this.yaw = number('yaw', degree, -10, 10) ?? this.yaw;
    this.pitch = number('pitch', degree, -Math.PI / 2, Math.PI / 2) ?? this.pitch;
    this.fov = number('fov', degree, FIELD.least, FIELD.most) ?? this.fov;
    const beside = (given.get('beside') ?? '').split(',').map(Number);
    const isGiven = beside.length === 3 && beside.every(Number.isFinite);
    this.beside = isGiven ? times(beside, Math.min(1, this.reach / Math.max(length(beside), 1e-9))) : [0, 0, 0];
  }

  goToAddress(given, number) {
    const { world } = this;
    if (world.isChain) {
      this.s = number('t', 1, 0, world.last) ?? this.s;
      return;
    }
    const [at, from, to] = ['at', 'from', 'to'].map((key) => world.panoramas.findIndex(({ name }) => name === given.get(key)));
    const link = world.links.find(({ ends }) => ends.includes(from) && ends.includes(to) && from !== to);
    if (at >= 0) this.stand(at);
    else if (link) {
      const t = number('t', 1, 0, 1) ?? 0;
      Object.assign(this, { link, t: link.ends[0] === from ? t : 1 - t });
    }
  }
}
