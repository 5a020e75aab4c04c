// The page: what was packed into it is unpacked, shown, and walked through.

const $ = (id) => document.getElementById(id);
const MOST_PIXELS = 2560 * 1440;
const SLOW = 40; // milliseconds of a frame above which pictures are made smaller while something moves

class Page {
  constructor(walk) {
    this.world = new World(walk, new Blocks(walk.files));
    this.walker = new Walker(this.world);
    this.walker.address = location.hash;
    this.isStill = matchMedia('(prefers-reduced-motion: reduce)').matches;
    Object.assign(this, { share: 1, isWaiting: false, before: null, renderer: null, movedAt: 0 });
    this.open(walk);
    this.wire();
  }

  open(walk) {
    const canvas = $('view');
    const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, powerPreference: 'high-performance' });
    this.canvas = canvas;
    try {
      if (!gl) throw new Error('WebGL2 is not available');
      this.gl = gl;
      this.renderer = new Renderer(gl, walk.tables);
    } catch (error) {
      this.useFade(error);
      return;
    }
    canvas.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();
      this.renderer = null;
      this.say('The picture was lost; waiting for it to come back …');
    });
    canvas.addEventListener('webglcontextrestored', () => {
      this.world.forgetGraphics();
      this.renderer = new Renderer(gl, walk.tables);
      this.say('');
      this.change();
    });
  }

  // A canvas that was asked for WebGL gives nothing else.
  useFade(error) {
    const fresh = this.canvas.cloneNode(false);
    this.canvas.replaceWith(fresh);
    this.canvas = fresh;
    this.fade = new FlatFade(fresh);
    this.gl = null;
    this.say(`This browser cannot draw surfaces (${error.message}): the panoramas are cross-faded.`);
  }

  wire() {
    const { walker, world } = this;
    this.controls = new Controls($('stage'), walker, () => this.change(), (x, y) => this.walkTowards(x, y));
    this.gyroscope = new Gyroscope(walker, () => this.change());
    $('place').max = world.last;
    $('place').addEventListener('input', (event) => {
      Object.assign(walker, { s: Number(event.target.value), beside: [0, 0, 0], isPlaying: false, goal: null });
      this.change();
    });
    $('play').addEventListener('click', () => this.togglePlay());
    $('whole').addEventListener('click', () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()));
    $('whole').hidden = !document.fullscreenEnabled;
    $('sensors').hidden = !Gyroscope.isThere;
    $('sensors').addEventListener('click', async () => $('sensors').setAttribute('aria-pressed', await this.gyroscope.toggle()));
    const showHint = (isShown) => {
      $('hint').hidden = !isShown;
      $('help').setAttribute('aria-expanded', isShown);
    };
    $('help').addEventListener('click', () => showHint($('hint').hidden));
    window.addEventListener('keydown', (event) => event.key === 'Escape' && showHint(false));
    Headset.isThere().then((isThere) => { $('headset').hidden = !(isThere && this.renderer); });
    $('headset').addEventListener('click', () => this.headset.enter(() => this.change()));
    document.addEventListener('fullscreenchange', () => {
      $('whole').setAttribute('aria-label', document.fullscreenElement ? 'Leave full screen' : 'Full screen');
    });
    window.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLInputElement) return;
      if (event.key === 'Home' || event.key === 'End') this.goTo(event.key === 'Home' ? 0 : world.last);
      else if (event.key === '?') $('help').click();
      else if (event.key === 'f') $('whole').click();
    });
    window.addEventListener('keydown', (event) => {
      if (event.code !== 'Space' || event.target instanceof HTMLButtonElement) return;
      event.preventDefault();
      this.togglePlay();
    });
    window.addEventListener('resize', () => this.change());
    window.addEventListener('hashchange', () => {
      if (location.hash === this.written) return;
      Object.assign(walker, { address: location.hash, isPlaying: false, goal: null });
      this.change();
    });
    this.stops = world.panoramas.map((panorama, index) => this.makeStop(panorama, index));
  }

  get headset() {
    return new Headset(this.gl, this.renderer, this.walker, this.world);
  }

  // A button where a panorama was taken: it leads there.
  makeStop(panorama, index) {
    const button = document.createElement('button');
    button.className = 'stop';
    button.title = panorama.name;
    button.setAttribute('aria-label', `Walk to panorama ${index + 1}, ${panorama.name}`);
    button.addEventListener('click', () => this.goTo(index));
    $('stops').append(button);
    return button;
  }

  goTo(s) {
    this.walker.goTo(s, this.isStill);
    this.change();
  }

  togglePlay() {
    if (this.walker.isPlaying) this.walker.isPlaying = false;
    else this.walker.play();
    this.change();
  }

  walkTowards(x, y) {
    const { walker, world } = this;
    const ring = this.stops.indexOf(document.elementFromPoint(x, y)); // the stage has the pointer, no ring is clicked
    if (ring >= 0) return this.goTo(ring);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const lens = lensOf(walker.fov, [width, height]);
    const ray = rotated(walker.rotation, [(2 * x / width - 1) / lens[0], (1 - 2 * y / height) / lens[1], -1]);
    const way = world.along(world.pairAt(walker.s).pair);
    const isAhead = !way || dot(ray, way) > 0;
    return this.goTo(isAhead ? Math.floor(walker.s + 1 + 1e-6) : Math.ceil(walker.s - 1 - 1e-6));
  }

  // The panorama that is nearest first, then the pair that one stands in and its neighbours.
  async load() {
    const { world, walker } = this;
    const { pair, t } = world.pairAt(walker.s);
    await world.photograph(pair + Math.round(t));
    this.change();
    if (this.fade) await Promise.all(world.panoramas.map((_, k) => world.photograph(k)));
    else await this.unpack(pair);
    $('progress').hidden = true;
    document.body.dataset.state = 'ready';
    this.change();
  }

  // Pairs near the one that is walked through; what was near before is forgotten.
  async unpack(pair) {
    const { world } = this;
    this.unpackedFor = pair;
    const wanted = world.near(pair).filter((index) => !world.isReady(index));
    $('progress').max = wanted.length;
    for (const [done, index] of wanted.entries()) {
      if (this.unpackedFor !== pair) return;
      this.say(index === pair || document.body.dataset.state === 'loading' ? `Unpacking surfaces, ${done + 1} of ${wanted.length} …` : '');
      $('progress').value = done;
      await world.pair(index);
      this.change();
    }
    this.say('');
  }

  failed(error) {
    $('progress').hidden = true;
    this.say(`This walk cannot be shown: ${error.message}`);
    document.body.dataset.state = 'failed';
    throw error;
  }

  say(words) {
    $('status').textContent = words;
    $('loading').hidden = words === '';
  }

  change() {
    this.movedAt = performance.now();
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame((time) => this.frame(time));
  }

  frame(time) {
    this.isWaiting = false;
    if (this.walker.hasMoved) document.body.dataset.moved = '';
    const seconds = this.before === null ? 0 : Math.min((time - this.before) / 1000, 0.5);
    const keys = this.controls.advance(seconds), isMoving = this.walker.advance(seconds) || keys;
    this.before = isMoving || this.controls.held.size ? time : null;
    this.draw();
    this.showPlace();
    const { pair } = this.world.pairAt(this.walker.s);
    if (!this.fade && this.unpackedFor !== undefined && this.unpackedFor !== pair) this.unpack(pair).catch((error) => this.failed(error));
    if (isMoving || this.walker.isPlaying || this.walker.goal !== null) this.change();
    else this.settle();
  }

  // At rest the whole picture is drawn, and the address says where one is.
  settle() {
    clearTimeout(this.settling);
    this.settling = setTimeout(() => {
      if (this.share < 1) this.draw(1);
      this.written = this.walker.address;
      history.replaceState(null, '', this.written);
    }, 250);
  }

  draw(share = this.share) {
    const ratio = Math.min(window.devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / Math.max(innerWidth * innerHeight, 1)));
    const size = [innerWidth, innerHeight].map((count) => Math.max(Math.round(count * ratio * share), 16));
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1]) [this.canvas.width, this.canvas.height] = size;
    if (this.fade) this.fade.draw(this.walker, this.world);
    else if (this.renderer) this.drawSurfaces(size);
  }

  drawSurfaces(size) {
    const { walker, world, renderer, gl } = this;
    const scene = world.sceneAt(gl, walker.s);
    if (!scene) return;
    const begin = performance.now();
    const eye = { position: walker.position, rotation: walker.rotation, lens: lensOf(walker.fov, size) };
    renderer.draw(eye, scene, { viewport: [0, 0, ...size], unknown: walker.strangeness });
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits, so that it can be timed
    this.milliseconds = performance.now() - begin;
    this.firstPicture ??= performance.now();
    const better = Math.sqrt(SLOW / 2 / Math.max(this.milliseconds, 1));
    this.share = clamp(this.milliseconds > SLOW || this.share < 1 ? this.share * clamp(better, 0.7, 1.1) : 1, 0.35, 1);
  }

  showPlace() {
    const { walker, world } = this;
    $('place').value = walker.s;
    const { pair, t } = world.pairAt(walker.s);
    const between = t === 0 || t === 1 ? world.panoramas[pair + t].name
      : `${Math.round(100 * t)} % of the way from ${world.panoramas[pair].name} to ${world.panoramas[pair + 1].name}`;
    $('place').setAttribute('aria-valuetext', between);
    $('play').setAttribute('aria-label', walker.isPlaying ? 'Pause' : 'Play');
    $('play').dataset.state = walker.isPlaying ? 'playing' : 'paused';
    this.stops.forEach((stop, index) => this.placeStop(stop, index));
  }

  // On the ground below where the panorama was taken, if that is in front; nearer ones no lower than one looks.
  placeStop(stop, index) {
    const { walker, world } = this;
    const from = minus(world.panoramas[index].position, walker.position);
    const away = Math.hypot(from[0], from[2]);
    const seen = unrotated(walker.rotation, [from[0], Math.max(from[1] - world.panoramas[index].eyeHeight, -0.6 * away), from[2]]);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const lens = lensOf(walker.fov, [width, height]);
    const [x, y] = [lens[0] * seen[0] / -seen[2], lens[1] * seen[1] / -seen[2]];
    const isNeighbour = Math.abs(index - walker.s) <= 1.001 && Math.abs(index - walker.s) > 0.02;
    stop.hidden = !isNeighbour || seen[2] >= 0 || away < 0.05 || Math.abs(x) > 1 || Math.abs(y) > 1;
    if (stop.hidden) return;
    stop.style.transform = `translate(${(x + 1) * width / 2}px, ${(1 - y) * height / 2}px) scale(${clamp(2.5 / away, 0.5, 1.2)})`;
  }

  // What is seen from a pose, for tests and for other programs: see docs/view.md.
  async capture(pose, fov, size) {
    const s = this.world.nearestTo(pose.position);
    await this.world.pair(this.world.pairAt(s).pair);
    const eye = { ...pose, lens: lensOf(fov * Math.PI / 180, size) };
    return this.renderer.capture(eye, this.world.sceneAt(this.gl, s), size);
  }
}

const page = new Page(JSON.parse($('walk').textContent));
const ready = page.load().catch((error) => page.failed(error));
window.omnisyn = { ready, page, capture: (pose, fov, size) => page.capture(pose, fov, size) };
