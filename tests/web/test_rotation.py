"""The page's rotations: light that is dragged for hours stays where it was dragged to."""

from pathlib import Path

from playwright.sync_api import Page

ROTATION = Path(__file__).resolve().parents[2] / "web" / "rotation.js"

DRAGS = 100_000

DRIFT = """async (drags) => {
  const { aboutAxis, cameraAxes, compose, dragLight, fromAngles } = await import("/rotation.js");
  let [values, truth, worst, seed] = [{ yaw: 0, pitch: 0, roll: 0 }, [1, 0, 0, 0], 0, 1];
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647 - 0.5;
  for (let i = 0; i < drags; i++) {
    const [azimuth, elevation, right, down] = [360, 160, 10, 10].map((range) => range * random());
    values = dragLight({ ...values, azimuth, elevation }, right, down);
    const tilt = aboutAxis(cameraAxes(azimuth, elevation).right, down);
    truth = compose(aboutAxis([0, 0, 1], right), compose(tilt, truth));
    truth = truth.map((v) => v / Math.hypot(...truth));
    const same = fromAngles(values).reduce((sum, v, k) => sum + v * truth[k], 0);
    worst = Math.max(worst, Math.hypot(...fromAngles(values).map((v, k) => v - Math.sign(same) * truth[k])));
  }
  return worst;
}"""


def test_a_hundred_thousand_drags_are_the_rotation_they_make(page: Page) -> None:
    page.route("http://page.test/", lambda route: route.fulfill(body="", content_type="text/html"))
    page.route("**/rotation.js", lambda route: route.fulfill(path=ROTATION, content_type="text/javascript"))
    page.goto("http://page.test/")
    assert page.evaluate(DRIFT, DRAGS) < 1e-9
