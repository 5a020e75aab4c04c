// What the page carries: blocks of bytes in base64, or files beside it; maps in them are predicted and deflated.

class Blocks {
  constructor(names) {
    this.names = names; // of files, or null where blocks are inside the page
  }

  async bytes(id) {
    if (this.names) {
      if (location.protocol === 'file:') throw new Error('browsers read the files of a folder from a web server only, such as omnisyn view --serve');
      const answer = await fetch(this.names[id]);
      if (!answer.ok) throw new Error(`${this.names[id]}: expected a file of this walk, got ${answer.status}`);
      return new Uint8Array(await answer.arrayBuffer());
    }
    const element = document.getElementById(`block-${id}`);
    const text = atob(element.textContent);
    const bytes = new Uint8Array(text.length);
    for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
    return bytes;
  }

  async picture(photo) {
    const blob = new Blob([await this.bytes(photo.block)], { type: photo.type });
    return createImageBitmap(blob, { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
  }

  // A map of `rows × cols` whole numbers of one or two bytes.
  async map({ block, rows, cols, depth }) {
    const stream = new Blob([await this.bytes(block)]).stream().pipeThrough(new DecompressionStream('deflate'));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const count = rows * cols;
    const values = depth === 2 ? new Uint16Array(count) : planes;
    if (depth === 2) for (let k = 0; k < count; k++) values[k] = planes[k] | (planes[count + k] << 8);
    undoPrediction(values, rows, cols);
    return values;
  }
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
