"""What a person does first: looks, turns, cuts, saves, reloads."""
import json
import re
import subprocess
import time

from PIL import Image

from browser.people import AXE, PATIENCE, PROGRAM, Person, Server, drag, test


@test("points.ply")
def a_scan_opens_and_its_picture_is_that_of_render(browser, server, folder):
    person = Person(browser, server)
    assert "token" not in person.page.url, "the token stays in the address"
    person.is_what_render_makes(folder)
    person.shot("opened")
    person.well()


@test("points.ply")
def drags_turn_wheels_come_nearer_keys_fly_and_changes_are_taken_back(browser, server, folder):
    person = Person(browser, server)
    person.converged()
    start = person.camera()
    assert sorted(map(abs, start["up"])) == [0, 0, 1], f"turns about {start['up']}, which is no axis"
    drag(person.page, (160, 40))
    turned = person.camera()
    assert turned["direction"] != start["direction"] and abs(turned["distance"] - start["distance"]) < 1e-9
    person.page.mouse.wheel(0, -300)
    person.wait(f"rayset.view.camera.distance < {turned['distance'] * 0.9}")
    person.is_what_render_makes(folder)
    person.shot("turned")
    person.page.locator("#picture").focus()
    before = person.camera()
    person.page.keyboard.down("w")
    time.sleep(0.3)
    person.page.keyboard.up("w")
    assert person.camera()["position"] != before["position"]
    for _ in range(3):
        person.page.keyboard.press("Control+z")
    assert person.camera()["position"] == start["position"], "everything has been taken back"
    person.well()


@test("points.ply")
def a_section_box_and_the_sun_change_the_picture_and_reloading_keeps_them(browser, server, folder):
    person = Person(browser, server)
    whole, _ = person.pixels()
    slider = person.page.get_by_label("x to", exact=True)
    slider.focus()
    for _ in range(60):
        person.page.keyboard.press("ArrowLeft")
    cut, _ = person.pixels()
    assert cut != whole
    person.is_what_render_makes(folder)
    person.shot("cut")
    person.page.get_by_label("Shadows").check()
    person.page.get_by_label("Exposure").fill("0.5")
    lit, _ = person.pixels()
    assert lit != cut
    person.is_what_render_makes(folder)
    state = person.evaluate("JSON.stringify(rayset.view.state)")
    person.page.reload()
    person.wait("window.rayset && window.rayset.view.scene")
    assert person.evaluate("JSON.stringify(rayset.view.state)") == state
    assert person.pixels()[0] == lit
    person.well()


@test("points.ply")
def pictures_of_any_size_are_saved_and_views_are_kept(browser, server, folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    person.page.get_by_label("width in pixels").fill("1500")
    person.page.get_by_label("height in pixels").fill("1000")
    with person.page.expect_download(timeout=PATIENCE) as download:
        person.page.get_by_role("button", name="Save picture").click()
    picture = folder / "large.png"
    download.value.save_as(picture)
    scene = json.loads(person.saved(folder).read_text())
    scene["image"]["size"] = [1500, 1000]
    (folder / "large.json").write_text(json.dumps(scene))
    subprocess.run([PROGRAM, "render", str(folder / "large.json"), "-o", str(folder / "large-too.png")],
                   check=True, capture_output=True)
    assert Image.open(picture).tobytes() == Image.open(folder / "large-too.png").tobytes()
    # One that is given up, long before it could be complete.
    person.page.get_by_label("width in pixels").fill("3000")
    person.page.get_by_label("height in pixels").fill("2400")
    person.page.get_by_role("button", name="Save picture").click()
    second = person.evaluate("rayset.view.picture([64, 64]).then(() => 'saved', (error) => error.message)")
    assert "already" in second, second
    person.page.get_by_role("button", name="Cancel").click()
    person.wait("[...document.querySelectorAll('.caption')].some((each) => each.textContent === 'cancelled')")
    first = person.camera()
    person.page.get_by_label("Name of the view to keep").fill("the front")
    person.page.get_by_role("button", name="Keep view").click()
    drag(person.page, (100, 40))
    assert person.camera() != first
    person.page.reload()
    person.opened()
    person.page.get_by_role("button", name="Go to the front").click()
    assert person.camera() == first
    person.page.get_by_role("button", name="Delete the front").click()
    assert person.page.get_by_role("button", name="Go to the front").count() == 0
    person.well()


@test("points.ply")
def the_engine_shows_its_working_set(browser, server, _folder):
    person = Person(browser, server)
    person.converged()
    person.page.get_by_label("Show memory").check()
    person.wait("document.querySelector('.numbers td:last-child')")
    report = person.evaluate("rayset.view.engine(true)")
    kinds = {kind["name"]: kind for kind in report["kinds"]}
    assert kinds["points"]["reads"] > 0 and kinds["points"]["hits"] > kinds["points"]["misses"], kinds
    assert 0 < sum(kind["bytes"] for kind in report["kinds"]) <= report["budget"]
    assert len(report["regions"]) == len(report["resident"]) > 0 and max(report["resident"]) == 1
    drawn = person.evaluate("""(() => {
        const map = document.querySelector("canvas.map");
        return map.getContext("2d").getImageData(0, 0, map.width, map.height).data.filter((v, i) => i % 4 === 3 && v > 0).length;
    })()""")
    assert drawn > 1000, f"{drawn} pixels of the map are drawn"
    person.page.locator("canvas.map").scroll_into_view_if_needed()
    person.shot("engine")
    person.well()


@test("sheet.ply")
def everything_can_be_reached_with_the_keyboard_and_has_a_name(browser, server, _folder):
    person = Person(browser, server)
    person.converged()
    person.page.locator("#picture").focus()
    before = person.camera()
    person.page.keyboard.press("f")
    person.wait(f"rayset.view.camera.distance !== {before['distance']}")
    person.page.keyboard.press("h")
    person.wait(f"Math.abs(rayset.view.camera.distance - {before['distance']}) < 1e-9")
    person.page.get_by_role("button", name="Add a box").click()
    # Handles are there once the picture has their place.
    person.page.get_by_label("Box 1, place: arrow keys move it").wait_for()
    reached = set()
    person.page.locator("#picture").focus()
    for _ in range(120):
        person.page.keyboard.press("Tab")
        name = person.evaluate("(document.activeElement.ariaLabel || document.activeElement.labels?.[0]?.textContent || "
                               "document.activeElement.textContent || '').trim()")
        if person.evaluate("document.activeElement === document.body"):
            break
        assert name, person.evaluate("document.activeElement.outerHTML")
        reached.add(name)
    for wanted in ("Show all", "Look", "Exposure", "Shadows", "x from", "Add a ball", "Remove Box 1", "Save scene", "Show memory",
                   "Box 1, place: arrow keys move it"):
        assert wanted in reached, f"{wanted} cannot be reached: {sorted(reached)}"
    if AXE:
        person.page.get_by_label("Section box", exact=True).check()
        person.page.get_by_label("Show memory").check()
        person.converged()
        for scheme in ("dark", "light"):
            person.page.emulate_media(color_scheme=scheme)
            person.evaluate(AXE)
            found = person.evaluate("axe.run().then(({ violations }) => violations.map(({ id, impact, nodes }) => "
                                    "[id, impact, nodes.map(({ target }) => String(target)).slice(0, 4)]))")
            serious = [each for each in found if each[1] in ("serious", "critical")]
            assert not serious, serious
            person.shot(scheme)
    person.well()


@test("points.ply")
def two_people_look_at_different_things(browser, server, folder):
    first = Person(browser, server)
    address = first.evaluate("rayset.view.invitation()")
    second = Person(browser, server, address, width=640, height=480)
    drag(first.page, (120, 0))
    second.page.locator("#picture").focus()
    second.page.keyboard.press("-")
    first.is_what_render_makes(folder)
    second.is_what_render_makes(folder)
    first.well()
    second.well()


@test("points.ply")
def a_telephone_has_room_for_it(browser, server, _folder):
    person = Person(browser, server, width=375, height=720, has_touch=True)
    person.converged()
    wide = person.evaluate("document.documentElement.scrollWidth")
    assert wide <= 375, f"{wide} pixels wide"
    person.shot("telephone")
    person.page.get_by_role("button", name="Settings").click()
    # The picture has another size a moment later.
    time.sleep(0.5)
    person.converged()
    person.shot("telephone-folded")
    person.well()


@test()
def a_page_goes_on_when_the_server_comes_back(browser, folder):
    cloud = folder / "points.ply"
    server = Server(cloud, folder)
    person = Person(browser, server)
    drag(person.page, (80, 0))
    before, _ = person.pixels()
    server.end()
    person.wait("document.getElementById('status').textContent.startsWith('not connected')")
    again = Server(cloud, folder, server.port)
    person.wait("document.getElementById('status').textContent.startsWith('complete')")
    assert person.pixels()[0] == before
    again.end()


@test()
def a_page_waits_while_its_scan_is_built(browser, folder):
    large = folder / "large.ply"
    subprocess.run([PROGRAM, "generate", "knot-1m", "-o", str(large)], check=True, capture_output=True)
    server = Server(large, folder)
    context = browser.new_context(viewport={"width": 640, "height": 480})
    page = context.new_page()
    said = []
    page.goto(server.address)
    until = time.time() + PATIENCE / 1000
    while not (said and said[-1].startswith("complete")) and time.time() < until:
        said.append(page.locator("#status").text_content())
        time.sleep(0.02)
    assert any(re.fullmatch(r"(reading|writing|spacing|building): \d+ %", text) for text in said), set(said)
    assert said[-1].startswith("complete"), said[-1]
    server.end()
