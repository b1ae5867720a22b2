"""That the page says what is so: legends, picks, its own state; and that nothing is lost."""
import math
import re
import time

from browser.inputs import FINE, field_height, fine_point, voxel
from browser.people import Person, Server, drag, test

BAR = """(() => {
    const bar = document.querySelector("canvas.bar");
    const data = bar.getContext("2d").getImageData(0, bar.height - 22, bar.width, 1).data;
    return [...Array(bar.width).keys()].map((i) => [...data.subarray(4 * i, 4 * i + 3)]);
})()"""


def shades(person):
    """How many colours the bar has that differ by more than a little."""
    found = []
    for color in person.evaluate(BAR):
        if not found or max(abs(a - b) for a, b in zip(color, found[-1])) > 8:
            found.append(color)
    return len(found)


@test("sheet.ply")
def the_bar_shows_the_colours_of_a_logarithmic_map(browser, server, _folder):
    person = Person(browser, server)
    person.page.get_by_label("Look", exact=True).select_option("gas")
    person.wait("rayset.view.legend?.look === 'gas'")
    person.converged()
    assert shades(person) > 20, f"{shades(person)} colours"
    assert person.page.get_by_label("Logarithmic").is_checked()
    assert person.page.get_by_label("Colour map", exact=True).input_value() == "inferno"
    assert "log scale" in person.page.locator("canvas.bar").get_attribute("aria-label")
    # Small numbers are read whole.
    person.evaluate("""(rayset.view.changes = { ...rayset.view.changes, style: { look: "gas", colormap: "magma", log: true,
        valueRange: [4.60009e-10, 2.71828e-7] } })""")
    person.converged()
    for end in ("lower", "upper"):
        wide = person.evaluate(f"(({{ scrollWidth, clientWidth, value }}) => [scrollWidth, clientWidth, value])"
                               f"(document.querySelector('[aria-label=\"value at the {end} end of the colour map\"]'))")
        assert wide[0] <= wide[1], wide
    assert person.page.get_by_label("value at the lower end of the colour map").input_value() == "4.60009e-10"
    assert shades(person) > 20
    person.page.locator("canvas.bar").scroll_into_view_if_needed()
    person.shot("bar")
    person.well()


@test("field.las")
def colours_that_no_map_has_are_not_called_by_the_name_of_one(browser, server, _folder):
    person = Person(browser, server)
    for look, name in (("classes", None), ("intensity", None), ("height", "viridis")):
        person.page.get_by_label("Look", exact=True).select_option(look)
        person.wait(f"rayset.view.legend?.look === {look!r}")
        person.converged()
        chosen = person.page.get_by_label("Colour map", exact=True)
        if chosen.is_visible():
            assert chosen.input_value() == (name or ""), (look, chosen.input_value())
    person.well()


@test("body.nrrd")
def the_colours_of_a_ct_scan_are_not_called_by_the_name_of_a_map(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    assert "Hounsfield" in person.evaluate("rayset.view.legend.line")
    chosen = person.page.get_by_label("Colour map", exact=True)
    assert chosen.is_visible() and chosen.input_value() == "", chosen.input_value()
    assert chosen.evaluate("each => each.selectedOptions[0].textContent") == "that of the look"
    assert shades(person) > 3
    person.shot("ct")
    # Another map has its name, and the look's own comes back.
    chosen.select_option("magma")
    person.converged()
    assert chosen.input_value() == "magma"
    chosen.select_option("")
    person.converged()
    assert chosen.input_value() == ""
    person.well()


@test("organs.seg.nrrd")
def labels_are_listed_by_name_in_their_colours(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    assert person.evaluate("rayset.view.legend.look") == "labels"
    listed = person.page.locator("ul.classes li")
    assert listed.all_text_contents() == ["liver", "200"]
    swatch = person.evaluate("getComputedStyle(document.querySelector('.classes .swatch')).backgroundColor")
    assert swatch == "rgb(204, 51, 0)", swatch
    assert not person.page.locator("canvas.bar").is_visible() and not person.page.get_by_label("Logarithmic").is_visible()
    listed.first.scroll_into_view_if_needed()
    person.shot("labels")
    # Values in colours of a map have a bar.
    person.page.get_by_label("Look", exact=True).select_option("volume")
    person.wait("rayset.view.legend?.look === 'volume'")
    person.converged()
    assert person.page.locator("canvas.bar").is_visible() and listed.count() == 0
    person.well()


@test("field.las")
def classes_are_listed_by_name(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    listed = person.page.locator("ul.classes li")
    # Chosen by the program, and by a person: the same scene.
    for look in ("", "classes"):
        person.page.get_by_label("Look", exact=True).select_option(look)
        person.wait("rayset.view.legend?.look === 'classes'")
        person.converged()
        assert listed.all_text_contents() == ["ground", "building"], look
    person.well()


@test("field.las")
def a_pick_has_the_unit_and_the_digits_of_its_file(browser, server, _folder):
    person = Person(browser, server)
    person.converged()
    for at in ((0.5, 0.5), (0.4, 0.4)):
        person.page.mouse.click(*person.at(*at))
        time.sleep(0.4)
    person.wait("document.querySelectorAll('#panels caption').length === 2")
    place = person.page.locator("#panels td").first.text_content()
    found = re.fullmatch(r"(4\d{5}(?:\.\d{1,2})?), (57\d{5}(?:\.\d{1,2})?), (\d+(?:\.\d{1,2})?) m", place)
    assert found, place
    x, y, z = map(float, found.groups())
    assert abs(z - field_height(x - 400_000, y - 5_700_000)) < 0.02, place
    apart = person.page.locator(".distance").text_content()
    assert re.fullmatch(r"Distance \d+(\.\d{1,2})? m", apart), apart
    # The answer is in sight, whatever panels are open.
    box = person.page.locator(".distance").bounding_box()
    assert 0 <= box["y"] and box["y"] + box["height"] <= 600, box
    person.shot("picked-metres")
    person.well()


def is_of_its_file(browser, server, decimals):
    """Asks the page for points that lie far denser than their files' digits say more."""
    person = Person(browser, server, width=720, height=480)
    person.converged()
    for k, at in enumerate(((0.5, 0.5), (0.45, 0.55), (0.6, 0.5), (0.42, 0.48))):
        person.page.mouse.click(*person.at(*at))
        time.sleep(0.4)
        person.wait(f"document.querySelectorAll('#panels caption').length === {min(k + 1, 2)}")
        place = person.page.locator("#panels td:has-text(', ')").last.text_content()
        numbers = re.findall(r"\d+(?:\.\d+)?", place)
        assert len(numbers) == 3 and all(len(each.partition(".")[2]) <= decimals for each in numbers), place
        x, y, z = map(float, numbers)
        column, row = round((x - 400_000) / FINE), round((y - 5_700_000) / FINE)
        of_file = [round(v, decimals) for v in fine_point(column, row)]
        assert max(abs(a - b) for a, b in zip((x - 400_000, y - 5_700_000, z), of_file)) < 1e-6, (place, of_file)
    apart = person.page.locator(".distance").text_content()
    digits = re.match(r"Distance \d+(?:\.(\d+))?", apart)[1] or ""
    assert len(digits) <= decimals, apart
    person.well()


@test("centimetres.las")
def a_pick_of_a_scan_in_centimetres_has_no_digit_below(browser, server, _folder):
    is_of_its_file(browser, server, 2)


@test("millimetres.las")
def a_pick_of_a_scan_in_millimetres_has_no_digit_below(browser, server, _folder):
    is_of_its_file(browser, server, 3)


@test("centimetres.xyz")
def a_pick_of_text_has_the_decimals_of_its_rows(browser, server, _folder):
    is_of_its_file(browser, server, 2)


@test("slope.nrrd")
def a_pick_of_a_grid_tells_its_value_and_one_of_the_sky_keeps_what_was_told(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    person.page.mouse.click(*person.at(0.5, 0.5))
    person.wait("document.querySelectorAll('#panels caption').length === 1")
    pick = person.evaluate("rayset.view.pick(0.5, 0.5)")
    near = {voxel(*(round(v) + d for v, d in zip(pick["position"], by)))
            for by in ((0, 0, 0),) + tuple(tuple(s * (k == axis) for k in range(3)) for axis in range(3) for s in (-1, 1))}
    assert pick["value"] in near, (pick, near)
    told = person.evaluate("document.querySelector('#panels caption').parentElement.textContent")
    assert "value" in told, told
    person.page.mouse.click(*person.at(0.02, 0.02))
    person.page.get_by_text("Nothing is seen there.").wait_for()
    assert person.evaluate("document.querySelectorAll('#panels caption').length") == 1, "what was told stays"
    person.well()


@test("sheet.ply")
def a_drag_that_comes_back_to_its_start_picks_nothing(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    x, y = person.at(0.5, 0.5)
    person.page.mouse.move(x, y)
    person.page.mouse.down()
    person.page.mouse.move(x + 60, y + 20, steps=6)
    person.page.mouse.move(x + 1, y, steps=6)
    person.page.mouse.up()
    person.converged()
    # A click is told after a quarter of a second.
    time.sleep(0.6)
    person.page.mouse.click(*person.at(0.45, 0.55))
    time.sleep(0.6)
    person.wait("document.querySelectorAll('#panels caption').length > 0")
    assert person.evaluate("document.querySelectorAll('#panels caption').length") == 1
    person.well()


@test("sheet.ply")
def what_was_taken_back_is_done_again_and_a_reload_forgets_neither(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    states = [person.camera()]
    undo, redo = (person.page.get_by_role("button", name=name) for name in ("Undo", "Redo"))
    assert undo.is_disabled() and redo.is_disabled()
    for by in ((60, 0), (0, 40), (-30, 20)):
        drag(person.page, by)
        states.append(person.camera())
    assert undo.is_enabled() and redo.is_disabled()
    person.page.keyboard.press("Control+z")
    # What only asks changes nothing.
    person.page.mouse.click(*person.at(0.5, 0.5))
    person.wait("document.querySelectorAll('#panels caption').length === 1")
    assert redo.is_enabled()
    assert person.camera() == states[2]
    person.converged()
    person.page.reload()
    person.opened()
    assert person.camera() == states[2]
    person.page.keyboard.press("Control+Shift+z")
    assert person.camera() == states[3]
    for k in (2, 1, 0):
        person.page.get_by_role("button", name="Undo").click()
        assert person.camera() == states[k], k
    assert undo.is_disabled()
    person.page.keyboard.press("Control+y")
    assert person.camera() == states[1]
    person.page.get_by_role("button", name="Redo").click()
    assert person.camera() == states[2]
    person.well()


@test("sheet.ply")
def a_new_window_begins_with_what_this_one_shows(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    drag(person.page, (90, 20))
    person.page.get_by_label("Exposure").fill("1")
    person.converged()
    state = person.evaluate("JSON.stringify(rayset.view.state)")
    with person.context.expect_page() as opened:
        person.page.get_by_role("button", name="New window").click()
    page = opened.value
    page.locator("#status", has_text="complete").wait_for(timeout=60_000)
    debugger = person.context.new_cdp_session(page)
    there = debugger.send("Runtime.evaluate", {"expression": "JSON.stringify(rayset.view.state)", "returnByValue": True})
    assert there["result"]["value"] == state
    person.well()


@test("points.ply")
def the_page_is_as_tall_as_its_window(browser, server, _folder):
    person = Person(browser, server)
    address = person.evaluate("rayset.view.invitation()")
    for person, height in ((person, 600), (Person(browser, server, address, width=375, height=720), 720)):
        person.converged()
        tall = person.evaluate("document.documentElement.scrollHeight")
        assert tall <= height, f"{tall} pixels of {height}"
    person.well()


def taken(person):
    """The part of the picture's width or height that what is seen takes, the larger of both."""
    pixels, (wide, high) = person.pixels()
    behind = pixels[:4]
    seen = [i for i in range(wide * high) if pixels[4 * i:4 * i + 4] != behind]
    columns, rows = {i % wide for i in seen}, {i // wide for i in seen}
    assert 0 < min(columns) and max(columns) < wide - 1 and 0 < min(rows) and max(rows) < high - 1, "it is cropped"
    return max((max(columns) - min(columns)) / wide, (max(rows) - min(rows)) / high)


def fills_windows_of_all_shapes(browser, server):
    person = Person(browser, server, width=360, height=640, has_touch=True)
    for width, height in ((360, 640), (390, 844), (844, 390), (1400, 400)):
        person.page.set_viewport_size({"width": width, "height": height})
        # The picture has another shape a moment later.
        time.sleep(0.5)
        assert taken(person) > 0.8, f"{taken(person):.0%} of {width}×{height}"
    person.page.set_viewport_size({"width": 360, "height": 640})
    for _ in range(2):
        person.page.get_by_role("button", name="Settings").click()
        time.sleep(0.5)
        assert taken(person) > 0.8, f"{taken(person):.0%} with settings folded, and unfolded again"
    drag(person.page, (90, 20))
    person.page.mouse.move(*person.at(0.5, 0.5))
    person.page.mouse.wheel(0, 300)
    person.converged()
    for button in ("Show all", "Look from +x", "Look from +z", "Show all"):
        person.page.get_by_role("button", name=button).click()
        assert taken(person) > 0.8, f"{taken(person):.0%} after {button}"
    person.page.get_by_label("Orthographic").check()
    person.page.get_by_role("button", name="Look from −y").click()
    assert taken(person) > 0.8, f"{taken(person):.0%} by parallel rays"
    person.shot("telephone-whole")
    person.well()


@test("points.ply")
def a_knot_fills_windows_of_all_shapes_until_somebody_moves_it(browser, server, _folder):
    fills_windows_of_all_shapes(browser, server)


@test("field.las")
def a_field_fills_windows_of_all_shapes_until_somebody_moves_it(browser, server, _folder):
    fills_windows_of_all_shapes(browser, server)


@test()
def a_page_that_is_not_connected_does_not_say_that_it_traces(browser, folder):
    server = Server(folder / "sheet.ply", folder)
    person = Person(browser, server, width=720, height=480)
    person.converged()
    server.end()
    person.wait("document.getElementById('status').textContent.startsWith('not connected')")
    person.evaluate("""(() => {
        window.said = [];
        const status = document.getElementById("status");
        new MutationObserver(() => window.said.push(status.textContent)).observe(status, { childList: true, characterData: true, subtree: true });
    })()""")
    drag(person.page, (60, 20))
    assert person.status().startswith("not connected"), person.status()
    said = person.evaluate("window.said")
    assert all(text.startswith("not connected") for text in said), said


@test("splats.ply")
def remarks_of_the_program_are_on_the_page(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    said = person.page.get_by_label("Remarks").text_content()
    assert "left out height:" in said, said
    # Where its file is kept is for the terminal.
    assert "built" not in said and "cache" not in said, said
    person.shot("remarks")
    person.well()


@test("points.ply")
def a_screen_that_has_more_pixels_than_the_memory_is_told(browser, server, _folder):
    person = Person(browser, server, width=1600, height=1000, device_scale_factor=2)
    person.converged()
    picture, screen = person.evaluate("[rayset.view.sharpness.picture, rayset.view.sharpness.screen]")
    assert picture[0] < screen[0]
    said = person.page.get_by_label("Remarks").text_content()
    assert "×".join(map(str, picture)) in said and "--memory" in said, said
    person.well()


@test("points.ply")
def a_telephone_with_more_pixels_than_the_memory_comes_to_rest(browser, server, _folder):
    person = Person(browser, server, width=390, height=844, device_scale_factor=3, has_touch=True)
    for _ in range(2):
        person.page.get_by_role("button", name="Settings").click()
        time.sleep(0.5)
        person.converged()
        time.sleep(0.5)
        person.converged()
        # What is said of it takes no room from the picture, which would be traced again.
        shown = person.evaluate("[rayset.view.shown, rayset.view.sharpness.wanted]")
        time.sleep(1.5)
        assert person.evaluate("rayset.view.isConverged") and person.evaluate("[rayset.view.shown, rayset.view.sharpness.wanted]") == shown
    person.well()


@test("sheet.ply")
def the_fifth_page_is_told_why_it_is_not_connected(browser, server, _folder):
    pages = [Person(browser, server, width=400, height=300)]
    for _ in range(3):
        pages.append(Person(browser, server, pages[0].evaluate("rayset.view.invitation()"), width=400, height=300))
    page = pages[0].context.new_page()
    page.goto(f"http://127.0.0.1:{server.port}/")
    page.get_by_text("4 pages are open").wait_for(timeout=60_000)
    # It is served once there is a place.
    pages[3].context.close()
    page.locator("#status", has_text="complete").wait_for(timeout=60_000)
    assert math.isfinite(pages[0].camera()["distance"])
