// The tour from above: panoramas, links, a floor plan, where one is and which way one looks. North (−z) is up.

const MAP = { side: 190, least: 70, rim: 14, dot: 5 }; // pixels
const OTHER_FLOOR = 2; // metres above or below, where panoramas are on another floor

class TourMap {
  constructor(root, world, onGo) {
    this.world = world;
    this.panel = root.getElementById('map');
    this.gaze = root.getElementById('gaze');
    this.needle = root.getElementById('needle');
    this.needle.hidden = !world.walk.isGeographic;
    const { corners } = world.walk.plan ?? {};
    const places = world.panoramas.map(({ position }) => [position[0], position[2]]);
    const outline = corners ? [...corners, [corners[1][0] + corners[2][0] - corners[0][0], corners[1][1] + corners[2][1] - corners[0][1]]] : [];
    const [low, high] = [Math.min, Math.max].map((most) => [0, 1].map((axis) => most(...[...places, ...outline].map((at) => at[axis]))));
    const spans = [0, 1].map((axis) => Math.max(high[axis] - low[axis], 0.1));
    this.scale = (MAP.side - 2 * MAP.rim) / Math.max(...spans);
    const size = spans.map((span) => Math.max(this.scale * span + 2 * MAP.rim, MAP.least));
    this.origin = [0, 1].map((axis) => size[axis] / 2 - this.scale * (low[axis] + high[axis]) / 2);
    [this.panel.style.width, this.panel.style.height] = size.map((count) => `${count}px`);
    root.getElementById('ways').setAttribute('d', world.links.map(({ ends }) => {
      const [from, to] = ends.map((end) => this.at(world.panoramas[end].position).join(' '));
      return `M${from}L${to}`;
    }).join(''));
    this.dots = world.panoramas.map((panorama) => this.makeDot(panorama, onGo));
    root.getElementById('dots').append(...this.dots);
    if (corners) this.showFloor(root.getElementById('floor'), corners);
  }

  at(position) {
    return [this.origin[0] + this.scale * position[0], this.origin[1] + this.scale * position[2]];
  }

  makeDot({ index, title, position }, onGo) {
    const dot = document.createElement('button');
    dot.className = 'dot';
    dot.title = title;
    dot.setAttribute('aria-label', `Go to ${title}`);
    const [x, y] = this.at(position);
    dot.style.transform = `translate(${x - MAP.dot}px, ${y - MAP.dot}px)`;
    dot.addEventListener('click', () => onGo(index));
    return dot;
  }

  async showFloor(image, corners) {
    const { plan } = this.world.walk;
    const [corner, right, below] = corners.map(([x, z]) => this.at([x, 0, z]));
    const [across, down] = [[right, plan.width], [below, plan.height]].map(([end, count]) => [0, 1].map((axis) => (end[axis] - corner[axis]) / count));
    image.style.transform = `matrix(${[...across, ...down, ...corner].join(', ')})`;
    const address = await this.world.blocks.address(plan).catch(() => null); // the map does without
    if (!address) return;
    image.src = address;
    image.hidden = false;
    image.addEventListener('load', () => URL.revokeObjectURL(address), { once: true });
  }

  show(walker) {
    const { position, yaw, nearest } = walker;
    const [x, y] = this.at(position);
    this.gaze.setAttribute('transform', `translate(${x} ${y}) rotate(${yaw * 180 / Math.PI})`);
    this.needle.style.transform = `rotate(${-yaw}rad)`;
    if (this.nearest === nearest) return;
    this.nearest = nearest;
    this.dots.forEach((dot, index) => {
      const isHere = index === nearest;
      dot.toggleAttribute('data-here', isHere);
      if (isHere) dot.setAttribute('aria-current', 'location');
      else dot.removeAttribute('aria-current');
      const away = this.world.panoramas[index].position[1] - this.world.panoramas[nearest].position[1];
      dot.toggleAttribute('data-elsewhere', Math.abs(away) > OTHER_FLOOR);
    });
  }
}
