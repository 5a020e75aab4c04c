// The walk: panoramas along a way, pairs of neighbours with their surfaces, loaded when they are needed.

class World {
  constructor(walk, blocks) {
    Object.assign(this, { walk, blocks });
    this.panoramas = walk.panoramas.map((panorama) => ({ ...panorama, bitmap: null }));
    this.lengths = walk.panoramas.slice(1).map((next, k) => length(minus(next.position, walk.panoramas[k].position)));
    this.last = walk.panoramas.length - 1;
    this.maps = new Map(); // of pairs: decoded maps
    this.onGraphics = new Map(); // of photographs and pairs: textures and surfaces
    this.pending = new Map();
  }

  // Where somebody is who has come so far: panorama k is at k.
  pointAt(s) {
    const { pair, t } = this.pairAt(s);
    return mixed(this.panoramas[pair].position, this.panoramas[pair + 1].position, t);
  }

  pairAt(s) {
    const pair = clamp(Math.floor(s), 0, this.last - 1);
    return { pair, t: clamp(s - pair, 0, 1) };
  }

  along(pair) {
    const way = minus(this.panoramas[pair + 1].position, this.panoramas[pair].position);
    return this.lengths[pair] > STILL ? times(way, 1 / this.lengths[pair]) : null;
  }

  // How far along the way the place is that is nearest to a position.
  nearestTo(position) {
    let best = { s: 0, distance: Infinity };
    for (let pair = 0; pair < this.last; pair++) {
      const direction = this.along(pair);
      const from = minus(position, this.panoramas[pair].position);
      const t = direction ? clamp(dot(from, direction) / this.lengths[pair], 0, 1) : 0;
      const distance = length(minus(position, this.pointAt(pair + t)));
      if (distance < best.distance) best = { s: pair + t, distance };
    }
    return best.s;
  }

  once(key, make) {
    if (!this.pending.has(key)) {
      this.pending.set(key, make().catch((error) => { this.pending.delete(key); throw error; }));
    }
    return this.pending.get(key);
  }

  photograph(index) {
    return this.once(`photo ${index}`, async () => {
      const panorama = this.panoramas[index];
      panorama.usable = panorama.mask && await this.blocks.map(panorama.mask);
      panorama.bitmap = await this.blocks.picture(panorama.photo);
      return panorama;
    });
  }

  pair(index) {
    return this.once(`pair ${index}`, async () => {
      await Promise.all([this.photograph(index), this.photograph(index + 1)]);
      const maps = await Promise.all(this.walk.pairs[index].surfaces.map(async (surface) => ({
        rows: surface.rows, cols: surface.cols, poles: surface.poles,
        inverseDepth: inverseDepths(await this.blocks.map(surface.inverseDepth), surface.peak),
        quads: await this.blocks.map(surface.quads),
        trust: surface.trust && await this.blocks.map(surface.trust),
      })));
      this.maps.set(index, maps);
    });
  }

  isReady(pair) {
    return this.maps.has(pair);
  }

  // What is drawn at a place of the way: both views of its pair, flat and cross-faded as long as surfaces are missing.
  sceneAt(gl, s) {
    const { pair, t } = this.pairAt(s);
    const isReady = this.isReady(pair);
    const { isCrossFade, exposure } = this.walk.pairs[pair];
    const views = [0, 1].map((k) => this.viewOf(gl, pair, k, isReady, exposure?.[k]));
    const shown = views.filter((view) => view !== null);
    if (shown.length < 2) return shown.length && { t: 0, isCrossFade: true, views: [shown[0], shown[0]] };
    this.forgetFarFrom(gl, pair);
    return { t, isCrossFade: isCrossFade || !isReady, views };
  }

  viewOf(gl, pair, k, isReady, gains) {
    const panorama = this.panoramas[pair + k];
    if (!panorama.bitmap) return null;
    const made = this.kept(`photo ${pair + k}`, () => ({
      photo: photoTexture(gl, panorama.bitmap),
      mask: panorama.usable && byteTexture(gl, panorama.mask.cols, panorama.mask.rows, panorama.usable, gl.REPEAT,
        gl.LINEAR_MIPMAP_LINEAR),
    }));
    const { position, rotation } = panorama;
    const surface = isReady ? this.kept(`surface ${pair} ${k}`, () => new Surface(gl, this.maps.get(pair)[k])) : null;
    const exposure = gains && isReady ? this.kept(`exposure ${pair} ${k}`, () => new Exposure(gl, gains, k)) : null;
    return { ...made, position, rotation, surface, exposure };
  }

  kept(key, make) {
    if (!this.onGraphics.has(key)) this.onGraphics.set(key, make());
    return this.onGraphics.get(key);
  }

  // The pair that is walked through and its neighbours, nearest first.
  near(pair) {
    return [pair, pair + 1, pair - 1].filter((index) => index >= 0 && index < this.last);
  }

  // Of what lies farther away only the packed bytes stay.
  forgetFarFrom(gl, pair) {
    const near = this.near(pair);
    for (const index of this.maps.keys()) if (!near.includes(index)) this.forget(`pair ${index}`, () => this.maps.delete(index));
    this.panoramas.forEach((panorama, index) => {
      if (!panorama.bitmap || near.some((one) => one === index || one + 1 === index)) return;
      this.forget(`photo ${index}`, () => {
        panorama.bitmap.close();
        panorama.bitmap = null;
      });
    });
    this.forgetTextures(gl, pair);
  }

  forget(key, drop) {
    this.pending.delete(key);
    drop();
  }

  forgetTextures(gl, pair) {
    for (const [key, made] of this.onGraphics) {
      const [kind, index] = key.split(' ');
      const distance = Number(index) - pair;
      if (kind === 'photo' ? distance >= -1 && distance <= 2 : Math.abs(distance) <= 1) continue;
      if (made.dispose) made.dispose();
      else [made.photo, made.mask].forEach((one) => one && gl.deleteTexture(one));
      this.onGraphics.delete(key);
    }
  }

  // After a context was lost nothing of it is left to be deleted.
  forgetGraphics() {
    this.onGraphics.clear();
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

  // omnisyn_cli.fusion.photometry.exposure_matcher.clipped_weight_loss
  lossOfWhite(t) {
    const stops = Math.min(0, ...this.white.map((gain) => (t - this.end) * gain));
    return Math.min(MAX_CLIPPED_WEIGHT_LOSS, 1 - 2 ** (4 * stops));
  }

  dispose() {
    this.gl.deleteTexture(this.gains);
  }
}

const STILL = 1e-6; // metres between panoramas taken at one place
