// The walk: panoramas and the links between them. What is needed near a place is loaded, what lies farther away goes.

const MEGABYTE = 2 ** 20;
const BUDGET = { usual: 256 * MEGABYTE, phone: 112 * MEGABYTE }; // of graphics memory, besides the picture itself
const PHONE_COLUMNS = 2048; // of photographs on small screens
const VERTEX_BYTES = 18; // of a surface on the graphics processor, about
const MIP_SHARE = 4 / 3;
const STILL = 1e-6; // metres between panoramas taken at one place

class World {
  constructor(walk, blocks, gl, { isPhone = false, budget = BUDGET[isPhone ? 'phone' : 'usual'] } = {}) {
    Object.assign(this, { walk, blocks, gl, isPhone, budget });
    this.panoramas = walk.panoramas.map((panorama, index) => ({ ...panorama, index, links: [] }));
    this.links = walk.links.map((link, index) => {
      const [first, second] = link.panoramas.map((k) => this.panoramas[k]);
      const way = minus(second.position, first.position), metres = length(way);
      const made = { ...link, index, ends: link.panoramas, metres, way: metres > STILL ? times(way, 1 / metres) : null };
      for (const panorama of [first, second]) panorama.links.push(made);
      return made;
    });
    this.isChain = this.links.every((link, k) => link.ends[0] === k && link.ends[1] === k + 1);
    this.last = walk.panoramas.length - 1;
    this.things = new Map(); // what is loaded, by its key
    this.pending = new Map();
    this.wanted = new Set();
    Object.assign(this, { round: 0, era: 0 });
  }

  pointAt({ link, t }) {
    return mixed(this.panoramas[link.ends[0]].position, this.panoramas[link.ends[1]].position, t);
  }

  otherEnd(link, panorama) {
    return link.ends[0] === panorama ? link.ends[1] : link.ends[0];
  }

  // Metres that a link takes; panoramas at one place are a metre apart.
  lengthOf(link) {
    return link.metres > STILL ? link.metres : 1;
  }

  // The place on any link that is nearest to a position.
  nearestTo(position) {
    let best = { distance: Infinity };
    for (const link of this.links) {
      const from = minus(position, this.panoramas[link.ends[0]].position);
      const t = link.way ? clamp(dot(from, link.way) / link.metres, 0, 1) : 0;
      const distance = length(minus(position, this.pointAt({ link, t })));
      if (distance < best.distance) best = { link, t, distance };
    }
    return best;
  }

  // Metres from a place to every panorama, and the panorama before each on the shortest way (Dijkstra).
  distances({ link, t }) {
    const found = this.panoramas.map(() => ({ metres: Infinity, before: null, isDone: false }));
    found[link.ends[0]].metres = t * this.lengthOf(link);
    found[link.ends[1]].metres = (1 - t) * this.lengthOf(link);
    for (;;) {
      const open = found.map((one, k) => (one.isDone ? Infinity : one.metres));
      const here = open.indexOf(Math.min(...open));
      if (open[here] === Infinity) return found;
      found[here].isDone = true;
      for (const one of this.panoramas[here].links) {
        const next = found[this.otherEnd(one, here)], metres = found[here].metres + this.lengthOf(one);
        if (metres < next.metres) Object.assign(next, { metres, before: here });
      }
    }
  }

  // Panoramas on the shortest way from a place, the last one included; none where no links lead there.
  pathTo(place, panorama, found = this.distances(place)) {
    if (found[panorama].metres === Infinity) return [];
    const path = [];
    for (let k = panorama; k !== null; k = found[k].before) path.unshift(k);
    return path;
  }

  // A way through all panoramas that can be reached: on along a chain, else always to the nearest one not yet seen.
  pathThroughAll(place) {
    if (this.isChain) return this.panoramas.map((_, k) => k).slice(Math.floor(place.link.index + place.t) + 1);
    const path = [], left = new Set(this.panoramas.keys());
    for (let here = place; left.size;) {
      const found = this.distances(here);
      const next = [...left].reduce((a, b) => (found[b].metres < found[a].metres ? b : a));
      if (found[next].metres === Infinity) break;
      const part = this.pathTo(here, next, found);
      path.push(...part);
      part.forEach((k) => left.delete(k));
      const link = this.panoramas[next].links[0];
      here = { link, t: link.ends[0] === next ? 0 : 1 };
    }
    return path.filter((k, at) => k !== path[at - 1]);
  }

  // Standard deviation of an inverse depth that a panorama measured by stereo in a direction of the world: that of a
  // disparity over the longest baseline across the ray. Low trust stands for more.
  inverseDepthStd(index, direction, trust) {
    const { position, links } = this.panoramas[index];
    const across = links.map((link) => {
      const way = minus(this.panoramas[this.otherEnd(link, index)].position, position);
      return length(minus(way, times(direction, dot(way, direction))));
    });
    const { rows, isGiven } = this.walk.surfaces[this.surfaceOf(index)];
    return isGiven ? 0 : DISPARITY_STD * Math.PI / rows / trust ** 2 / Math.max(...across);
  }

  surfaceOf(index) {
    const [link] = this.panoramas[index].links;
    return link.surfaces[link.ends.indexOf(index)];
  }

  // What should be loaded, the most urgent first: all of the link that one stands in, then what fits of the next links.
  wants(walker) {
    const { link, nearest } = walker, other = this.otherEnd(link, nearest);
    const now = [
      this.photo(nearest, true), this.photo(nearest), this.mask(nearest), this.photo(other, true), ...this.surfaces(link),
      this.photo(other), this.mask(other),
    ];
    const toward = (one) => {
      const end = this.otherEnd(one, nearest);
      const from = minus(this.panoramas[end].position, this.panoramas[nearest].position);
      return end === walker.next ? 2 : dot(from, walker.ahead) / Math.max(length(from), STILL);
    };
    const links = this.panoramas[nearest].links.filter((one) => one !== link).sort((a, b) => toward(b) - toward(a));
    const soon = links.flatMap((one) => {
      const end = this.otherEnd(one, nearest);
      return [this.photo(end, true), ...this.surfaces(one), this.photo(end), this.mask(end)];
    });
    const known = new Set();
    let bytes = 0;
    return [...now, ...soon].filter((want, k) => {
      if (!want || known.has(want.key) || (k >= now.length && bytes + want.bytes > this.budget)) return false;
      known.add(want.key);
      bytes += want.bytes;
      return true;
    }).map((want) => ({ ...want, isNow: now.includes(want) }));
  }

  photo(index, isPreview = false) {
    const levels = this.panoramas[index].photo;
    const fits = levels.filter(({ width }) => !this.isPhone || width <= PHONE_COLUMNS);
    const level = isPreview || !fits.length ? levels[0] : fits.at(-1);
    return { key: `photo ${index} ${levels.indexOf(level)}`, ...this.thingOf(level) };
  }

  thingOf(picture) {
    const bytes = 4 * MIP_SHARE * picture.width * picture.height;
    return { bytes, make: async () => {
      const bitmap = await this.blocks.picture(picture);
      if (!this.gl) return { bytes, bitmap, dispose: () => bitmap.close() };
      const made = photoTexture(this.gl, bitmap);
      bitmap.close();
      return { bytes, texture: made, dispose: () => this.gl.deleteTexture(made) };
    } };
  }

  mask(index) {
    const { mask } = this.panoramas[index];
    if (!mask || !this.gl) return null;
    const bytes = MIP_SHARE * mask.rows * mask.cols;
    return { key: `mask ${index}`, bytes, make: async () => {
      const made = byteTexture(this.gl, mask.cols, mask.rows, await this.blocks.map(mask), this.gl.REPEAT, this.gl.LINEAR_MIPMAP_LINEAR);
      return { bytes, texture: made, dispose: () => this.gl.deleteTexture(made) };
    } };
  }

  // Both surfaces of a link, how its photographs are exposed, and what is added half way.
  surfaces(link) {
    if (!this.gl) return [];
    const surfaces = link.surfaces.map((index) => {
      const surface = this.walk.surfaces[index];
      return { key: `surface ${index}`, bytes: VERTEX_BYTES * surface.rows * surface.cols, make: async () => {
        const [codes, quads, trust] = await Promise.all(
          [surface.inverseDepth, surface.quads, surface.trust].map((map) => map && this.blocks.map(map)));
        return new Surface(this.gl, { ...surface, inverseDepth: inverseDepths(codes, surface.peak), quads, trust });
      } };
    });
    const exposure = link.exposure !== null && { key: `exposure ${link.index}`, bytes: 8192, make: async () => {
      const gains = await this.blocks.floats(link.exposure), half = gains.length / 2;
      const both = [0, 1].map((end) => new Exposure(this.gl, gains.subarray(end * half, (end + 1) * half), end));
      return { bytes: 8192, both, dispose: () => both.forEach((one) => one.dispose()) };
    } };
    const correction = link.correction && { key: `correction ${link.index}`, ...this.thingOf(link.correction) };
    return [...surfaces, exposure, correction];
  }

  // Loads what is wanted at a place. False: somewhere else became more urgent. `onStep` is told what has come. Fails
  // where something is missing that the place itself needs; what lies beyond it is asked for again when it is needed.
  async prepare(walker, onStep) {
    const wants = this.wants(walker), round = ++this.round;
    this.wanted = new Set(wants.map((want) => want.key));
    for (const [key, thing] of this.things) if (!this.wanted.has(key)) this.drop(key, thing);
    const [first, ...rest] = wants;
    const isStale = () => round !== this.round;
    const loaded = (want) => this.load(want).then(
      () => isStale() || onStep(wants), (error) => { if (want.isNow && !isStale()) throw error; });
    await loaded(first);
    await Promise.all(rest.filter((want) => want.isNow).map(loaded));
    for (const want of rest) {
      if (isStale()) return false;
      if (!this.things.has(want.key)) await loaded(want);
    }
    return !isStale();
  }

  load(want) {
    if (this.things.has(want.key)) return Promise.resolve();
    if (!this.pending.has(want.key)) {
      const { era } = this;
      const loaded = want.make().then((thing) => {
        if (this.wanted.has(want.key) && era === this.era) this.things.set(want.key, thing);
        else thing.dispose();
      });
      this.pending.set(want.key, loaded.finally(() => this.pending.delete(want.key)));
    }
    return this.pending.get(want.key);
  }

  // All of one link, whatever else is wanted.
  async need(link) {
    const wants = [...link.ends.flatMap((end) => [this.photo(end), this.mask(end)]), ...this.surfaces(link)].filter(Boolean);
    wants.forEach((want) => this.wanted.add(want.key));
    await Promise.all(wants.map((want) => this.load(want)));
  }

  drop(key, thing) {
    thing.dispose();
    this.things.delete(key);
  }

  isReady(link) {
    return link.surfaces.every((index) => this.things.has(`surface ${index}`));
  }

  // Bytes of graphics memory of all that is loaded.
  get bytes() {
    return [...this.things.values()].reduce((sum, thing) => sum + thing.bytes, 0);
  }

  // The largest picture of a panorama that is there, or null.
  pictureOf(index) {
    const { photo } = this.panoramas[index];
    for (let level = photo.length - 1; level >= 0; level--) {
      const thing = this.things.get(`photo ${index} ${level}`);
      if (thing) return thing;
    }
    return null;
  }

  // What is drawn at a place: both views of its link, flat where they are cross-faded and while surfaces are missing.
  sceneAt({ link, t }) {
    const isReady = this.isReady(link), isCrossFade = link.isCrossFade || !isReady;
    const views = link.ends.map((index, k) => {
      const picture = this.pictureOf(index), { position, rotation } = this.panoramas[index];
      if (!picture) return null;
      const surface = isCrossFade ? null : this.things.get(`surface ${link.surfaces[k]}`);
      const exposure = (isReady && this.things.get(`exposure ${link.index}`)?.both[k]) || null;
      const mask = this.things.get(`mask ${index}`)?.texture ?? null;
      return { photo: picture.texture, mask, position, rotation, surface, exposure };
    });
    const shown = views.filter((view) => view !== null);
    const isPlain = !isReady && (t === 0 || t === 1);
    if (shown.length < 2) return shown.length ? { t: 0, isCrossFade: true, isPlain: true, views: [shown[0], shown[0]] } : null;
    const correction = isReady ? this.things.get(`correction ${link.index}`)?.texture : null;
    return { t, isCrossFade, isPlain, views, correction, middle: this.pointAt({ link, t: 0.5 }) };
  }

  // Nothing is kept any more, nor what is still on its way.
  dispose() {
    this.round++;
    this.wanted.clear();
    this.things.forEach((thing, key) => this.drop(key, thing));
  }

  // After a context was lost nothing of it is left to be deleted.
  forgetGraphics() {
    this.things.clear();
    this.pending.clear();
    this.round++;
    this.era++;
  }
}

// How a picture is brought to the exposure of a place of the way: stops for each stored value, red, green, blue.
class Exposure {
  constructor(gl, gains, end) {
    Object.assign(this, { gl, end, white: gains.slice(-3) });
    const values = new Float32Array(gains.length / 3 * 4);
    for (let k = 0; k < gains.length; k++) values[4 * Math.floor(k / 3) + k % 3] = gains[k];
    this.gains = texture(gl, gl.CLAMP_TO_EDGE, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, gains.length / 3, 1, 0, gl.RGBA, gl.FLOAT, values);
  }

  // omnisyn_cli.fusion.photometry.clipped_weight_loss
  lossOfWhite(t) {
    const stops = Math.min(0, ...[...this.white].map((gain) => (t - this.end) * gain));
    return Math.min(MAX_CLIPPED_WEIGHT_LOSS, 1 - 2 ** (4 * stops));
  }

  dispose() {
    this.gl.deleteTexture(this.gains);
  }
}
