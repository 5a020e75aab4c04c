// Pointers, wheel, keys and sensors move a walker.

const KEYS = {
  ArrowUp: [0, 0, 1], KeyW: [0, 0, 1], ArrowDown: [0, 0, -1], KeyS: [0, 0, -1],
  KeyA: [-1, 0, 0], KeyD: [1, 0, 0], PageUp: [0, 1, 0], KeyE: [0, 1, 0], PageDown: [0, -1, 0], KeyQ: [0, -1, 0],
};
const TURNS = { ArrowLeft: -1, ArrowRight: 1 };
const TILTS = { ArrowUp: 1, ArrowDown: -1 }; // with the shift key
const ZOOMS = { Equal: -1, NumpadAdd: -1, Minus: 1, NumpadSubtract: 1 };
const TURNING = 1.2; // radians a second

// Whether a key is meant for a walk, and not for a browser's shortcut, a slider or a field.
const isForWalk = (event) => !(event.ctrlKey || event.metaKey || event.altKey || event.composedPath()[0] instanceof HTMLInputElement);

class Controls {
  // Pointers are those over `element`, keys those that `keys` is told about until `signal` ends it.
  constructor(element, keys, walker, onChange, onTap, signal) {
    Object.assign(this, { element, walker, onChange, onTap });
    this.pointers = new Map();
    this.aside = [0, 0]; // metres to the right and up, until the next picture
    this.held = new Set();
    element.addEventListener('pointerdown', (event) => this.press(event));
    element.addEventListener('pointermove', (event) => this.move(event));
    for (const kind of ['pointerup', 'pointercancel']) element.addEventListener(kind, (event) => this.release(event));
    element.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    element.addEventListener('contextmenu', (event) => event.preventDefault());
    keys.addEventListener('keydown', (event) => this.key(event, true), { signal });
    keys.addEventListener('keyup', (event) => this.key(event, false), { signal });
    for (const target of [keys, window]) target.addEventListener('blur', () => this.held.clear(), { signal });
  }

  get radiansPerPixel() {
    return this.walker.fov / this.element.clientHeight;
  }

  press(event) {
    this.element.setPointerCapture?.(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.travelled = this.pointers.size > 1 ? Infinity : 0;
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const others = [...this.pointers.entries()].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    this.travelled += Math.hypot(dx, dy);
    this.pointers.set(event.pointerId, now);
    if (others.length === 0 && !(event.buttons & 2)) {
      this.walker.turn(-dx * this.radiansPerPixel, this.walker.attitude ? 0 : dy * this.radiansPerPixel);
    } else {
      if (others.length === 1) {
        const gap = (at) => Math.hypot(at.x - others[0].x, at.y - others[0].y);
        this.walker.zoom(clamp(gap(before) / Math.max(gap(now), 1), 0.5, 2));
      }
      const metres = this.walker.reach / this.element.clientHeight; // two fingers or the right button: beside the way
      this.aside = [this.aside[0] - dx * metres, this.aside[1] + dy * metres]; // fingers of a pinch cancel each other
    }
    this.onChange();
  }

  release(event) {
    const at = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    if (event.type === 'pointerup' && event.button === 0 && at && this.travelled < 6) this.onTap(at.x, at.y);
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 16 : 1;
    if (event.ctrlKey) this.walker.zoom(Math.exp(0.01 * event.deltaY * lines)); // a pinch on a touch pad
    else this.walker.walk(-0.002 * event.deltaY * lines);
    this.interrupt();
  }

  key(event, isDown) {
    if (!isDown) this.held.delete(event.code); // wherever and with whatever it is let go
    if (!isForWalk(event)) return;
    if (![KEYS, TURNS, ZOOMS].some((keys) => event.code in keys)) return;
    event.preventDefault();
    this.isShifted = event.shiftKey;
    if (!isDown) return;
    this.held.add(event.code);
    this.interrupt();
    if (!event.repeat) this.follow(event.code, 0.05); // a key that is only touched moves a little
  }

  interrupt() {
    this.walker.stop();
    this.onChange();
  }

  // Whether keys that are held moved anything in so many seconds.
  advance(seconds) {
    const [right, up] = this.aside.splice(0, 2, 0, 0);
    if (Math.hypot(right, up) > 1e-9) this.walker.step(right, up, 0);
    for (const code of this.held) this.follow(code, seconds);
    return this.held.size > 0;
  }

  follow(code, seconds) {
    if (code in ZOOMS) this.walker.zoom(Math.exp(ZOOMS[code] * seconds));
    else if (code in TURNS) this.walker.turn(TURNS[code] * TURNING * seconds, 0);
    else if (this.isShifted && code in TILTS) this.walker.turn(0, TILTS[code] * TURNING * seconds);
    else this.walker.step(...KEYS[code].map((part) => part * this.walker.speed * seconds));
  }
}

// Turns a walker's look with the device. Browsers give orientations to pages from secure places only.
class Gyroscope {
  constructor(walker, onChange, signal) {
    Object.assign(this, { walker, onChange, isOn: false });
    this.listen = (event) => this.turned(event);
    signal.addEventListener('abort', () => window.removeEventListener('deviceorientation', this.listen));
  }

  static get isThere() {
    return window.isSecureContext && 'DeviceOrientationEvent' in window && navigator.maxTouchPoints > 0;
  }

  async toggle() {
    if (!this.isOn && DeviceOrientationEvent.requestPermission) {
      if (await DeviceOrientationEvent.requestPermission() !== 'granted') return this.isOn;
    }
    this.isOn = !this.isOn;
    window[this.isOn ? 'addEventListener' : 'removeEventListener']('deviceorientation', this.listen);
    if (!this.isOn) this.stop();
    return this.isOn;
  }

  stop() {
    const look = lookOfDirection(rotated(this.walker.rotation, [0, 0, -1]));
    Object.assign(this.walker, { ...look, attitude: null });
  }

  turned({ alpha, beta, gamma }) {
    if (alpha === null) return;
    const attitude = attitudeOfDevice(alpha, beta, gamma, screen.orientation?.angle ?? 0);
    if (!this.walker.attitude) this.walker.yaw -= lookOfDirection(rotated(attitude, [0, 0, -1])).yaw; // heading is kept
    this.walker.attitude = attitude;
    this.onChange();
  }
}

// The W3C's angles (z-x'-y'', degrees; z up) of a device whose screen is turned, as a rotation with y up.
function attitudeOfDevice(alpha, beta, gamma, screenAngle) {
  const [z, x, y, s] = [alpha, beta, gamma, -screenAngle].map((angle) => angle * Math.PI / 180);
  const aboutZ = (a) => [Math.cos(a), -Math.sin(a), 0, Math.sin(a), Math.cos(a), 0, 0, 0, 1];
  const aboutX = (a) => [1, 0, 0, 0, Math.cos(a), -Math.sin(a), 0, Math.sin(a), Math.cos(a)];
  const aboutY = (a) => [Math.cos(a), 0, Math.sin(a), 0, 1, 0, -Math.sin(a), 0, Math.cos(a)];
  const device = product(product(aboutZ(z), aboutX(x)), aboutY(y));
  return product(product([1, 0, 0, 0, 0, 1, 0, -1, 0], device), aboutZ(s));
}
