// The page around a walk: it fills the window, listens to all keys, and keeps its place in the address.

// The blocks of a page that holds its own walk.
async function heldBytes(block) {
  const text = atob(document.getElementById(`block-${block}`).textContent);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < bytes.length; k++) bytes[k] = text.charCodeAt(k);
  return bytes;
}

const held = document.getElementById('walk');
const source = held ? { manifest: JSON.parse(held.textContent), bytes: heldBytes } : 'walk.json';
const walk = new OmnisynWalk(document.body, source, { keys: window, keepsAddress: true });
window.omnisyn = { ready: walk.ready, page: walk, capture: (pose, fov, size) => walk.capture(pose, fov, size) };
