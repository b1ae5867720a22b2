"""Where the camera stands: standard views, parallel rays, and the command that repeats what is seen."""
import random
import shlex
import subprocess

from PIL import Image

from browser.people import PROGRAM, Person, drag, test


@test("field.las")
def standard_views_are_exact_with_north_up_and_show_the_whole(browser, server, folder):
    person = Person(browser, server, width=860, height=480)
    person.converged()
    drag(person.page, (70, 30))
    views = {"+z": [0, 0, -1], "−z": [0, 0, 1], "+x": [-1, 0, 0], "−x": [1, 0, 0], "+y": [0, -1, 0], "−y": [0, 1, 0]}
    for is_orthographic in (False, True):
        if is_orthographic:
            person.page.get_by_label("Orthographic").check()
        for name, direction in views.items():
            person.page.get_by_role("button", name=f"Look from {name}").click()
            camera = person.camera()
            assert camera["direction"] == direction, (name, camera["direction"])
            up = {"+z": [0, 1, 0], "−z": [0, -1, 0]}.get(name, [0, 0, 1])
            assert [v + 0 for v in camera["up"]] == up, (name, camera["up"])
            assert ("height" in camera) == is_orthographic
            reach = person.evaluate("""import('./camera.js').then((m) => {
                const { outline, camera, canvas } = rayset.view;
                const seen = outline.map((place) => m.project(camera, place, canvas.width / canvas.height));
                return [0, 1].map((axis) => Math.max(...seen.map((at) => Math.abs(at[axis]))));
            })""")
            assert max(reach) <= 1 and 0.85 < max(reach), f"{name} shows {reach} of the picture"
        person.page.get_by_role("button", name="Look from +z").click()
        person.is_what_render_makes(folder)
        north, south, east = (person.evaluate(f"rayset.view.pick({x}, {y})")["position"] for x, y in ((0.5, 0.35), (0.5, 0.65), (0.6, 0.65)))
        assert north[1] > south[1] and east[0] > south[0] and abs(north[0] - south[0]) < 3, (north, south, east)
        person.shot("north-up" + "-orthographic" * is_orthographic)
    # From above, a person turns about what is up.
    drag(person.page, (60, 0))
    camera = person.camera()
    assert max(abs(a - b) for a, b in zip(camera["direction"], [0, 0, -1])) < 1e-12 and abs(camera["up"][2]) < 1e-12, camera
    drag(person.page, (0, -90))
    assert person.camera()["up"] == [0, 0, 1], person.camera()
    person.is_what_render_makes(folder)
    person.well()


@test("sheet.ply", options=("--view", "top", "--orthographic"))
def a_view_that_was_started_orthographic_stays_so(browser, server, folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    camera = person.camera()
    assert camera["height"] > 150 and camera["direction"] == [0, 0, -1] and camera["up"] == [0, 1, 0], camera
    assert person.page.get_by_label("Orthographic").is_checked()
    person.is_what_render_makes(folder)
    drag(person.page, (0, -60))
    assert person.camera()["up"] == [0, 0, 1], "it turns about z"
    # By rays from an eye, what it turns about is as large as before.
    before, _ = person.pixels()
    person.page.get_by_label("Orthographic").uncheck()
    assert "height" not in person.camera()
    assert person.pixels()[0] != before
    person.page.get_by_label("Orthographic").check()
    assert abs(person.camera()["height"] - camera["height"]) < 1e-6 * camera["height"]
    person.page.get_by_role("button", name="Show all").click()
    assert person.camera()["height"] == camera["height"]
    person.well()


@test("sheet.ply")
def no_command_is_said_to_render_a_picture_that_has_changed(browser, server, _folder):
    person = Person(browser, server, width=560, height=240)
    hint = "document.querySelector('textarea').nextElementSibling.textContent"
    for act in (lambda: drag(person.page, (60, 20)), lambda: person.page.get_by_role("button", name="Add a box").click()):
        person.command()
        person.wait(f"{hint}.includes('byte for byte')")
        act()
        # The command follows the complete picture; until it has come, nothing is said of it.
        assert person.evaluate(f"rayset.view.isConverged || !{hint}.includes('byte for byte')")
    person.wait(f"{hint}.includes('Save the scene first')")
    person.well()


def is_what_the_command_renders(person, folder):
    words, is_whole = person.command()
    assert is_whole, f"no options say it: {words}"
    pixels, size = person.pixels()
    environment = {"XDG_CACHE_HOME": str(folder / "cache")}
    subprocess.run([PROGRAM, *words[1:]], check=True, capture_output=True, cwd=folder, env=environment)
    image = Image.open(folder / "picture.png").convert("RGBA")
    assert image.size == size, (image.size, size, words)
    differ = sum(a != b for a, b in zip(image.tobytes(), pixels))
    assert differ == 0, f"{differ} bytes differ: {shlex.join(words)}"


@test("field.las")
def options_say_standard_views_of_every_look_straight_from_above_too(browser, server, folder):
    person = Person(browser, server, width=560, height=240)
    for look in ("", "height", "surface"):
        person.page.get_by_label("Look", exact=True).select_option(look)
        for name in ("+z", "−z", "+x"):
            person.page.get_by_role("button", name=f"Look from {name}").click()
            is_what_the_command_renders(person, folder)
    person.page.get_by_label("Orthographic").check()
    is_what_the_command_renders(person, folder)
    person.page.get_by_role("button", name="Look from +z").click()
    is_what_the_command_renders(person, folder)
    person.well()


# States that are walked through.
STATES = 40


@test("sheet.ply")
def the_command_on_the_page_renders_its_bytes_in_every_state(browser, server, folder):
    person = Person(browser, server, width=560, height=240)
    chance = random.Random(32)

    def look(options):
        person.page.get_by_label("Look", exact=True).select_option(chance.choice(options))

    def option(label, options):
        select = person.page.get_by_label(label, exact=True)
        if select.is_visible():
            select.select_option(chance.choice(options))

    def restyle(part):
        person.evaluate(f"(() => {{ const {{ view }} = rayset; view.changes = {{ ...view.changes, style: "
                        f"{{ ...(view.changes.style ?? view.choices.style), {part} }} }}; }})()")

    def change(part):
        person.evaluate(f"(rayset.view.changes = {{ ...rayset.view.changes, {part} }})")

    moves = [
        lambda: drag(person.page, (chance.randint(-90, 90), chance.randint(-60, 60))),
        lambda: drag(person.page, (chance.randint(-90, 90), chance.randint(-60, 60))),
        lambda: (person.page.mouse.move(*person.at(0.5, 0.5)), person.page.mouse.wheel(0, chance.choice([-300, -100, 200]))),
        lambda: person.page.get_by_role("button", name=f"Look from {chance.choice(['+x', '−x', '+y', '−y', '+z', '−z'])}").click(),
        lambda: person.page.get_by_role("button", name="Show all").click(),
        lambda: person.page.get_by_label("Orthographic").click(),
        lambda: look(["", "density", "surface", "height", "gas"]),
        lambda: option("Colours", ["", "density", "warmth", "x", "z"]),
        lambda: option("Colour map", ["viridis", "plasma", "magma_r", "grey"]),
        lambda: person.page.get_by_label("Exposure").fill(str(chance.choice([-1, 0, 0.5, 1.5]))),
        lambda: restyle(f"radiusScale: {chance.choice([0.5, 1.25, 2])}"),
        lambda: restyle(f"color: undefined, colorBy: 'warmth', colormap: 'turbo', valueRange: [{chance.uniform(1, 20)}, {chance.uniform(50, 190)}]"),
        lambda: restyle("opacity: [[0, 0], [0.5, 0.25], [2, 1]]"),
        lambda: person.page.keyboard.press("Control+z"),
        lambda: person.page.keyboard.press("Control+Shift+z"),
        lambda: change("section: { min: [-60, -80, -20], max: [70, 90, 20] }"),
        lambda: change("section: undefined, sun: undefined"),
        lambda: change("section: undefined, sun: undefined"),
        lambda: change("sun: { direction: [0.3, 0.2, -1], intensity: 1.5, shadow: true }"),
    ]
    by_options = 0
    for state in range(STATES):
        if state:
            chance.choice(moves)()
        words, is_whole = person.command()
        by_options += is_whole
        # Options say everything but cuts and suns, and what is up where a look depends on it: then it is as in standard views.
        is_sayable = person.evaluate("((view) => !view.changes.sun && !view.changes.section && "
                                     "[view.camera.vertical, view.upAlong(view.camera.direction)].some((up) => "
                                     "view.camera.up.every((v, k) => v === up[k])))(rayset.view)")
        assert is_whole or not is_sayable, f"state {state} is not said by options"
        if not is_whole:
            person.saved(folder).rename(folder / "scene.json")
        pixels, size = person.pixels()
        assert words[:2] == ["rayset", "render"], words
        environment = {"XDG_CACHE_HOME": str(folder / "cache")}
        subprocess.run([PROGRAM, *words[1:]], check=True, capture_output=True, cwd=folder, env=environment)
        image = Image.open(folder / "picture.png").convert("RGBA")
        assert image.size == size, (image.size, size, words)
        differ = sum(a != b for a, b in zip(image.tobytes(), pixels))
        assert differ == 0, f"state {state}: {differ} bytes differ: {shlex.join(words)}"
    assert by_options >= STATES // 4, f"{by_options} of {STATES} states are said by options"
    person.well()
