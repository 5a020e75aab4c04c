// What a walk carries: blocks of bytes; maps in them are predicted and deflated.

class Blocks {
  constructor(read) {
    this.read = read; // gives the bytes of a block by its number, as a promise
    this.ahead = new Map();
  }

  fetchAhead(block) {
    const bytes = this.read(block);
    bytes.catch(() => {}); // said where the block is used
    this.ahead.set(block, bytes);
  }

  bytes(block) {
    const bytes = this.ahead.get(block) ?? this.read(block);
    this.ahead.delete(block);
    return bytes;
  }

  async picture(photo) {
    const blob = new Blob([await this.bytes(photo.block)], { type: photo.type });
    return createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
  }

  // An address for `<img>`; whoever asks revokes it.
  async address(photo) {
    return URL.createObjectURL(new Blob([await this.bytes(photo.block)], { type: photo.type }));
  }

  // A map of `rows × cols` whole numbers of one or two bytes.
  async map({ block, rows, cols, depth }) {
    const planes = await this.inflated(block);
    const count = rows * cols;
    const values = depth === 2 ? new Uint16Array(count) : planes;
    if (depth === 2) for (let k = 0; k < count; k++) values[k] = planes[k] | (planes[count + k] << 8);
    undoPrediction(values, rows, cols);
    return values;
  }

  async floats(block) {
    return new Float32Array((await this.inflated(block)).buffer);
  }

  async inflated(block) {
    const stream = new Blob([await this.bytes(block)]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }
}

// What a walk is made from: the address of its manifest, or an object with `manifest` and `bytes(block)`. `signal` ends
// what is being fetched.
async function openedSource(source, signal) {
  if (typeof source !== 'string' && !(source instanceof URL)) return source;
  const base = new URL(source, document.baseURI);
  const read = async (name) => {
    const answer = await fetch(new URL(name, base), { signal });
    if (!answer.ok) throw new Error(`${name}: expected a file of this walk, got ${answer.status}`);
    return answer;
  };
  const manifest = await (await read(base)).json();
  return { manifest, bytes: async (block) => new Uint8Array(await (await read(manifest.files[block])).arrayBuffer()) };
}

// Each value was kept as what it is above left + above − above left; beyond the first row and column all is 0.
function undoPrediction(values, rows, cols) {
  for (let k = 1; k < cols; k++) values[k] += values[k - 1];
  for (let row = 1; row < rows; row++) {
    const at = row * cols;
    values[at] += values[at - cols];
    for (let k = at + 1; k < at + cols; k++) values[k] += values[k - 1] + values[k - cols] - values[k - cols - 1];
  }
}

// Codes of the roots of inverse depth; the greatest code is a place without a surface.
function inverseDepths(codes, peak) {
  const values = new Float32Array(codes.length);
  for (let k = 0; k < codes.length; k++) {
    const root = codes[k] / (NO_SURFACE - 1);
    values[k] = codes[k] === NO_SURFACE ? -1e-9 : peak * root * root;
  }
  return values;
}

const NO_SURFACE = 65535;
