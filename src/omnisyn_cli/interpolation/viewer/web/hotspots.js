// Marks in the picture: at a point of the world, or in a direction. What stands before them hides them.

const MARK_TOLERANCE = 2 * SAME_POINT_TOLERANCE; // of inverse depth: two surfaces may differ by that much
const MARK_OFFSET = 1e-3; // 1/metre: a kilometre is as good as infinitely far

class Hotspots {
  constructor(root, world, onOpen) {
    Object.assign(this, { world, card: root.getElementById('card'), picture: root.getElementById('card-picture') });
    this.title = root.getElementById('card-title');
    this.link = root.getElementById('card-link');
    const own = world.panoramas.flatMap(({ index, hotspots }) => hotspots.map((spot) => ({ ...spot, panorama: index })));
    this.marks = [...own, ...world.walk.hotspots.map((spot) => ({ ...spot, panorama: null }))].map((spot) => {
      const button = document.createElement('button');
      button.className = 'mark';
      button.hidden = true;
      button.title = spot.text;
      button.setAttribute('aria-label', spot.text);
      button.addEventListener('click', () => onOpen(spot) && this.open(spot, button));
      return { spot, button };
    });
    root.getElementById('marks').append(...this.marks.map(({ button }) => button));
    root.getElementById('card-close').addEventListener('click', () => this.close());
    this.card.addEventListener('keydown', (event) => {
      if (event.key !== 'Escape') return;
      event.stopPropagation();
      this.close();
    });
  }

  async open({ text, link, image }, opener) {
    this.opener = opener;
    this.title.textContent = text;
    this.link.hidden = link === null;
    if (link !== null) [this.link.textContent, this.link.href] = [link, link];
    this.putAway();
    this.card.hidden = false;
    this.card.querySelector('button').focus();
    const shown = this.shown = {};
    const address = image && await this.world.blocks.address(image).catch(() => null); // the text stays without it
    if (!address) return;
    if (this.shown !== shown) return URL.revokeObjectURL(address); // meanwhile another one was opened, or none is
    shown.address = address;
    [this.picture.src, this.picture.alt, this.picture.hidden] = [address, text, false];
  }

  // The picture that is shown.
  putAway() {
    this.picture.hidden = true;
    this.picture.removeAttribute('src');
    if (this.shown?.address) URL.revokeObjectURL(this.shown.address);
    this.shown = null;
  }

  close() {
    this.putAway();
    this.card.hidden = true;
    this.opener?.focus();
  }

  // Where each mark of this place is in the picture; `lookUp` gives the nearest inverse depth at pixels, from below.
  show(walker, lens, [width, height], lookUp) {
    const { ends } = walker.link, seen = [];
    for (const { spot, button } of this.marks) {
      const isOwn = spot.panorama === null || (walker.panorama === null ? ends.includes(spot.panorama) : spot.panorama === walker.panorama);
      const [x, y, z, w] = spot.place;
      const from = isOwn && unrotated(walker.rotation, minus([x, y, z], times(walker.position, w)));
      const at = from && [lens[0] * from[0] / -from[2], lens[1] * from[1] / -from[2]];
      if (!at || from[2] >= 0 || Math.abs(at[0]) > 0.98 || Math.abs(at[1]) > 0.98) button.hidden = true;
      else seen.push({ button, rho: w / length(from), pixel: [(at[0] + 1) * width / 2, (at[1] + 1) * height / 2] });
    }
    const nearest = lookUp(seen.map(({ pixel }) => pixel));
    seen.forEach(({ button, rho, pixel: [x, y] }, k) => {
      button.hidden = nearest[k] !== null && nearest[k] > rho * (1 + MARK_TOLERANCE) + MARK_OFFSET;
      button.style.transform = `translate(${x}px, ${height - y}px)`;
    });
  }
}
