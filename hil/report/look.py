"""Opens pages in headless Chromium at several widths and in both themes, and has them measure themselves. See run.sh."""
import html
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import time

WIDTHS = [400, 1280]
# In the page's head: what goes wrong in any script of it. At its end: what is wider than the window or outside its picture.
HEAD = "<script>window.problems = []; addEventListener('error', e => problems.push('error: ' + e.message));</script>"
MEASURE = """<script>
addEventListener('load', () => {
  document.querySelectorAll('details').forEach(one => { one.open = true; });
  requestAnimationFrame(() => requestAnimationFrame(() => {
    const wide = document.documentElement.clientWidth, page = document.documentElement.scrollWidth;
    if (page > wide) problems.push(`the page is ${page} px wide`);
    const scrolls = one => { for (let at = one; at; at = at.parentElement) if (at.classList.contains('scroll')) return true; return false; };
    document.querySelectorAll('body *').forEach(one => {
      const box = one.getBoundingClientRect();
      if (box.width && !one.closest('svg') && !scrolls(one) && box.right > wide + 1)
        problems.push(`${one.tagName} ends at ${box.right.toFixed(0)} px: ${one.textContent.slice(0, 40).trim()}`);
    });
    document.querySelectorAll('svg').forEach(svg => {
      const room = svg.getBoundingClientRect();
      svg.querySelectorAll('text').forEach(text => {
        const box = text.getBoundingClientRect();
        if (box.width && (box.left < room.left - 1 || box.right > room.right + 1 || box.top < room.top - 1 || box.bottom > room.bottom + 1))
          problems.push(`label outside its plot: ${text.textContent.slice(0, 40)}`);
      });
    });
    document.querySelectorAll('th').forEach(head => { if (!head.title && head.textContent.trim()) problems.push('no tooltip: ' + head.textContent); });
    const shade = colour => { const [r, g, b] = colour.match(/[\\d.]+/g).map(Number); return 0.3 * r + 0.6 * g + 0.1 * b; };
    const style = getComputedStyle(document.body);
    parent.postMessage(JSON.stringify({ problems, ink: shade(style.color), paper: shade(style.backgroundColor), plots: document.querySelectorAll('svg').length }), '*');
  }));
});
</script>"""
FRAME = """<!doctype html><title>waiting</title><body style="margin:0"><iframe src="{page}" style="border:0;width:{width}px;height:900px"></iframe>
<script>addEventListener('message', event => {{ document.title = event.data; }});</script>"""


def run(browser, profile, *arguments):
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}", "--enable-logging=stderr"]
    done = subprocess.run([browser, *flags, *arguments], capture_output=True, text=True, timeout=120)
    console = [line for line in done.stderr.splitlines() if ":CONSOLE" in line]
    return done.stdout, console


def look(browser, folder, page, width, dark, tries=3):
    """What is wrong with a page at a width, as a list. On a busy machine a page may not be through in its time."""
    text = page.read_text()
    copy, frame = folder / "page.html", folder / "frame.html"
    copy.write_text(text.replace("<head>", "<head>" + HEAD, 1).replace("</body>", MEASURE + "</body>", 1))
    frame.write_text(FRAME.format(page=copy.name, width=width))
    scheme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    dom, console = run(browser, folder / "profile", scheme, "--virtual-time-budget=4000", f"--window-size={max(width, 600)},900", "--dump-dom", frame.as_uri())
    found = re.search(r"<title>(.*?)</title>", dom, re.S)
    try:
        seen = json.loads(html.unescape(found.group(1)))
    except (AttributeError, ValueError):
        if tries > 1:
            return look(browser, folder, page, width, dark, tries - 1)
        return [f"the page did not measure itself: {dom[:200]!r}"] + console
    problems = sorted(set(seen["problems"])) + console
    if (seen["ink"] > seen["paper"]) != dark or abs(seen["ink"] - seen["paper"]) < 120:
        problems.append(f"theme: text {seen['ink']:.0f} on {seen['paper']:.0f} of 255")
    if seen["plots"] == 0:
        problems.append("no plot")
    return problems


def main():
    browser, keep, *pages = sys.argv[1:]
    wrong = 0
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        for page in map(pathlib.Path, pages):
            for width in WIDTHS:
                for dark in [False, True]:
                    problems = look(browser, folder, page.resolve(), width, dark)
                    wrong += len(problems)
                    print(f"{page.name}, {width} px, {'dark' if dark else 'light'}: {'; '.join(problems[:8]) or 'held'}")
                    if keep:
                        picture = pathlib.Path(keep) / f"{page.stem}-{width}-{'dark' if dark else 'light'}.png"
                        run(browser, folder / "profile", f"--blink-settings=preferredColorScheme={0 if dark else 1}", f"--window-size={width},2400",
                            f"--screenshot={picture}", page.resolve().as_uri())
            pdf = (pathlib.Path(keep) if keep else folder) / f"{page.stem}.pdf"
            run(browser, folder / "profile", f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page.resolve().as_uri())
            sheets = len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes())) if pdf.exists() else 0
            wrong += sheets == 0
            print(f"{page.name}, print: {sheets} sheets")
    print(f"{'FAILED' if wrong else 'held'}: {len(pages)} pages in {time.monotonic() - begin:.0f} s")
    return 1 if wrong else 0


sys.exit(main())
