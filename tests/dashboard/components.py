"""Vue components of the dashboard without the dashboard: what browsers and servers call at the wrong time."""

from __future__ import annotations

from typing import Any

from tests.dashboard.stack import Page

STRAY = """
const [name, calls, done] = [arguments[0], arguments[1], arguments[arguments.length - 1]];
const loaded = performance.getEntriesByType("resource").map((one) => one.name);
const [vue, component] = await Promise.all([
  import("vue"), import(loaded.find((one) => one.endsWith(`/${name}`)))]);
const errors = [];
const stage = document.body.appendChild(document.createElement("div"));
stage.style = "width:600px;height:400px";
const watched = {...component.default, beforeMount() { at("before it is mounted", this); }};
const app = vue.createApp(watched, {label: "stray"});
app.config.errorHandler = app.config.warnHandler = (error) => errors.push(`${when}: ${error}`);
let when = "";
const turn = () => new Promise((ready) => setTimeout(ready, 60));
function at(time, shown) {
  when = time;
  for (const [method, ...values] of calls) {
    try { shown[method](...values); } catch (error) { errors.push(`${when}: ${method}: ${error}`); }
  }
}
function fire(elements) {
  const point = {bubbles: true, pointerId: 1, clientX: 300, clientY: 200, deltaY: 9};
  for (const element of elements) {
    for (const type of ["pointermove", "pointercancel", "pointerup", "pointerleave"])
      element.dispatchEvent(new PointerEvent(type, point));
    element.dispatchEvent(new WheelEvent("wheel", {...point, cancelable: true}));
    for (const key of ["ArrowLeft", "+", "0", "Enter", "ArrowDown"])
      element.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
    if (element.tagName !== "CANVAS") element.dispatchEvent(new MouseEvent("click", {bubbles: true}));
  }
}
window.addEventListener("error", (event) => errors.push(`${when}: ${event.message}`));
const shown = app.mount(stage);
when = "mounted, with nothing to show";
fire([...stage.querySelectorAll("*")]);
await turn();
at("mounted", shown);
await turn();
const elements = [...stage.querySelectorAll("*")];
fire(elements);
at("just before it goes", shown);
app.unmount();
when = "after it has gone";
fire(elements);
stage.style.width = "500px";
document.body.classList.toggle("stray");
at(when, shown);
await turn();
stage.remove();
done(errors);
"""


def stray_errors(page: Page, component: str, calls: list[list[Any]]) -> list[str]:
    """What goes wrong in a component when it is told things and pointed at before, while and after it is shown.

    The page has loaded it. `calls`: methods that the server calls, each with its arguments.
    """
    script = f"(async (...given) => {{ {STRAY.replace('arguments', 'given')} }})(...arguments)"
    found: list[str] = page.driver.execute_async_script(script, component, calls)
    return found
