// What the page does beyond showing: navigation, enlarged figures, everything open in print, the arm in three dimensions.
(() => {
  const nav = document.querySelector('nav');
  document.querySelectorAll('main h2').forEach((head, k) => {
    if (head.closest('.verdict') || head.dataset.nav === '') return;
    head.id = head.id || 'part-' + (k + 1);
    const link = nav.appendChild(document.createElement('a'));
    link.href = '#' + head.id;
    link.textContent = head.dataset.nav || head.textContent;
    link.addEventListener('click', () => { const part = head.closest('details'); if (part) part.open = true; });
  });
  document.querySelectorAll('figure').forEach(figure => {
    const svg = figure.querySelector('svg');
    if (!svg || svg.id === 'arm') return;
    svg.addEventListener('click', () => figure.classList.toggle('large'));
  });
  addEventListener('keydown', event => {
    if (event.key === 'Escape') document.querySelectorAll('.large').forEach(one => one.classList.remove('large'));
  });
  addEventListener('beforeprint', () => document.querySelectorAll('details').forEach(one => { one.open = true; }));

  const svg = document.getElementById('arm');
  if (!svg) return;
  const data = JSON.parse(document.getElementById('arm-data').textContent);
  let [turn, above] = data.view;
  let pose = 0, plays = false;
  const [box, sphere, way, links] = ['space', 'sphere', 'way', 'links'].map(name => svg.querySelector('.' + name));
  const joints = svg.querySelectorAll('.joint');
  const at = p => {
    const [x, y, z] = p.map((value, k) => value - data.middle[k]);
    const right = x * Math.cos(turn) - y * Math.sin(turn), away = x * Math.sin(turn) + y * Math.cos(turn);
    const up = z * Math.cos(above) + away * Math.sin(above);
    return [data.side / 2 + data.scale * right, data.side / 2 - data.scale * up];
  };
  const line = points => points.map((p, k) => (k ? 'L' : 'M') + at(p).map(value => value.toFixed(1)).join(' ')).join('');
  const edges = [];
  if (data.box) {
    const corner = k => [0, 1, 2].map(axis => data.box[k >> axis & 1][axis]);
    for (let k = 0; k < 8; k++) for (let axis = 0; axis < 3; axis++) if (!(k >> axis & 1)) edges.push([corner(k), corner(k | 1 << axis)]);
  }
  const circles = [[0, 1], [0, 2], [1, 2]].map(axes => Array.from({ length: 49 }, (_, k) => {
    const p = [0, 0, 0], angle = 2 * Math.PI * k / 48;
    p[axes[0]] = data.sphere * Math.cos(angle); p[axes[1]] = data.sphere * Math.sin(angle);
    return p;
  }));
  const draw = () => {
    box.setAttribute('d', edges.map(line).join(''));
    sphere.setAttribute('d', data.sphere ? circles.map(line).join('') : '');
    way.setAttribute('d', line(data.path));
    links.setAttribute('d', line(data.poses[pose]));
    joints.forEach((one, k) => { const [x, y] = at(data.poses[pose][k]); one.setAttribute('cx', x); one.setAttribute('cy', y); });
  };
  let from = null;
  svg.addEventListener('pointerdown', event => { from = [event.clientX, event.clientY]; svg.setPointerCapture(event.pointerId); });
  svg.addEventListener('pointerup', () => { from = null; });
  svg.addEventListener('pointermove', event => {
    if (!from) return;
    turn += (event.clientX - from[0]) / 120;
    above = Math.max(-1.5, Math.min(1.5, above + (event.clientY - from[1]) / 120));
    from = [event.clientX, event.clientY];
    draw();
  });
  const slider = document.getElementById('arm-time'), button = document.getElementById('arm-play');
  const show = k => { pose = k % data.poses.length; slider.value = pose; draw(); };
  slider.max = data.poses.length - 1;
  slider.addEventListener('input', () => show(+slider.value));
  let last = 0;
  const step = now => {
    if (!plays) return;
    if (now - last > 1000 * data.period / data.poses.length) { last = now; show(pose + 1); }
    requestAnimationFrame(step);
  };
  button.addEventListener('click', () => {
    plays = !plays;
    button.textContent = plays ? 'Pause' : 'Play';
    if (plays) requestAnimationFrame(step);
  });
})();
