"""A tab of the browser, as all tests of the page open it."""

from typing import Any

# Ten frames a second: most of a page's processor time is WebGL without a graphics card.
_SLOW_SCREEN = """{
    const ask = requestAnimationFrame.bind(window), stop = cancelAnimationFrame.bind(window);
    const asked = new Map();
    let count = 0, last = 0;
    window.requestAnimationFrame = draw => {
        const id = ++count;
        const turn = now => {
            if (now !== last && now - last < 100) return void asked.set(id, ask(turn));
            asked.delete(id);
            last = now;
            draw(now);
        };
        asked.set(id, ask(turn));
        return id;
    };
    window.cancelAnimationFrame = id => { stop(asked.get(id)); asked.delete(id); };
}"""


def new_tab(browser: Any, width: int = 1280, height: int = 720) -> Any:
    """A page of its own in the browser, on a slow screen."""
    tab = browser.new_page(viewport={"width": width, "height": height})
    tab.set_default_timeout(90_000)
    tab.add_init_script(_SLOW_SCREEN)
    return tab
