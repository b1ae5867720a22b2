"""Places of the picture: what is picked there, and what cuts there."""
import math
import re

from browser.inputs import sheet_height
from browser.people import Person, drag, test


@test("sheet.ply")
def a_pick_tells_of_the_point_that_is_seen_and_two_of_their_distance(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    box = person.page.locator("#picture").bounding_box()
    picked = []
    for x, y in ((0.5, 0.5), (0.4, 0.55)):
        person.page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        person.wait(f"document.querySelectorAll('#panels caption').length === {len(picked) + 1}")
        pick = person.evaluate(f"rayset.view.pick({x}, {y})")
        point = pick["point"]
        values = {name: value for name, value, _ in point["values"]}
        # What the file has at that place: see `sheet`.
        column, row = round((point["stored"][0] + 100) / 1), round((point["stored"][1] + 100) / 1)
        assert abs(point["stored"][2] - sheet_height(column, row)) < 1e-3, point
        assert abs(values["warmth"] - column) < 0.01, (values, column)
        assert math.dist(pick["position"], point["position"]) < 3
        seen = person.evaluate(
            f"import('./camera.js').then((m) => m.project(rayset.view.camera, {point['position']}, {box['width'] / box['height']}))")
        assert abs((seen[0] + 1) / 2 - x) < 0.02 and abs((1 - seen[1]) / 2 - y) < 0.02, (seen, x, y)
        picked.append(point["position"])
    apart = re.search(r"Distance ([0-9.]+)", person.page.locator(".distance").text_content())
    # As many digits are shown as are known.
    shown = 10.0 ** -len(apart[1].partition(".")[2])
    assert abs(float(apart[1]) - math.dist(*picked)) <= 0.51 * shown <= 0.01, (apart[0], picked)
    person.shot("picked")
    # Beside the sheet there is nothing.
    assert person.evaluate("rayset.view.pick(0.01, 0.01)")["position"] is None
    before = person.camera()
    person.page.mouse.dblclick(box["x"] + 0.4 * box["width"], box["y"] + 0.55 * box["height"])
    person.wait(f"rayset.view.camera.distance !== {before['distance']}")
    after = person.camera()
    pivot = [p + d * after["distance"] for p, d in zip(after["position"], after["direction"])]
    assert math.dist(pivot, picked[1]) < 3, (pivot, picked)
    person.well()


@test("points.ply")
def solids_cut_with_handles_and_cuts_are_filled(browser, server, folder):
    person = Person(browser, server, width=720, height=480)
    whole, _ = person.pixels()
    person.page.get_by_role("button", name="Add a ball").click()
    cut, _ = person.pixels()
    assert cut != whole
    person.is_what_render_makes(folder)
    person.page.get_by_label("Turn", exact=True).focus()
    for _ in range(20):
        person.page.keyboard.press("ArrowRight")
    assert person.evaluate("rayset.view.changes.cutters[0].turns[1].degrees") == 20
    person.page.keyboard.press("Control+z")
    assert person.page.get_by_label("Turn", exact=True).input_value() == "0", "the slider follows what is taken back"
    before = person.evaluate("rayset.view.changes.cutters[0]")
    handle = person.page.get_by_label("Ball 1, place: arrow keys move it").bounding_box()
    drag(person.page, (40, -10), (handle["x"] + handle["width"] / 2, handle["y"] + handle["height"] / 2))
    after = person.evaluate("rayset.view.changes.cutters[0]")
    assert after["center"] != before["center"] and after["size"] == before["size"]
    person.page.get_by_label("Ball 1, size along x: arrow keys move it").focus()
    for _ in range(8):
        person.page.keyboard.press("ArrowRight")
    person.converged()
    assert person.evaluate("rayset.view.changes.cutters[0].size")[0] != after["size"][0]
    person.shot("solid")
    person.is_what_render_makes(folder)
    person.page.get_by_label("Keep what is inside").check()
    assert person.pixels()[0] != cut
    person.is_what_render_makes(folder)
    person.page.get_by_role("button", name="Remove Ball 1").click()
    assert person.pixels()[0] == whole
    # The knot is hollow: a section through it shows its inside, or what fills it.
    person.page.get_by_label("Section box", exact=True).check()
    handle = person.page.get_by_label("Section box, z to: arrow keys move it")
    handle.focus()
    size = person.evaluate("rayset.view.changes.section.max[2]")
    for _ in range(60):
        person.page.keyboard.press("ArrowDown")
        if person.evaluate("rayset.view.changes.section.max[2]") < 0:
            break
        person.page.keyboard.press("ArrowLeft")
    assert person.evaluate("rayset.view.changes.section.max[2]") < size
    open_, _ = person.pixels()
    person.page.get_by_label("Fill cuts").check()
    filled, _ = person.pixels()
    assert filled != open_
    person.is_what_render_makes(folder)
    person.shot("filled")
    person.well()
