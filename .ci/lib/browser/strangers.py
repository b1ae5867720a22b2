"""Those who may not look."""
import json
import socket
import subprocess
import time
import urllib.error
import urllib.request

from browser.people import AXE, PATIENCE, PROGRAM, SHOTS, Person, Server, Stranger, drag, test


@test("points.ply")
def strangers_are_refused(browser, server, _folder):
    Person(browser, server).converged()

    def status(path, **headers):
        request = urllib.request.Request(f"http://127.0.0.1:{server.port}{path}", headers=headers)
        try:
            return urllib.request.urlopen(request, timeout=20).status
        except urllib.error.HTTPError as error:
            return error.code
    assert status("/") == 403
    assert status("/?token=" + "0" * 32) == 403
    assert status(server.address[server.address.index("/?"):]) == 403, "a used token opens again"
    assert status("/", Host="evil.example.org") == 403
    assert status("/style.css", Host="evil.example.org") == 403
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    assert status("/socket", **upgrade) == 403
    assert status("/socket", Origin="http://evil.example.org", **upgrade) == 403
    assert status("/socket", Origin=f"http://127.0.0.1:{server.port}", **upgrade) == 403, "no cookie"
    for path in ("/../Cargo.toml", "/%2e%2e/Cargo.toml", "/..%2fCargo.toml", "/none.js"):
        assert status(path) == 404, path


@test("points.ply")
def attackers_are_turned_away_and_others_are_served(browser, server, folder):
    person = Person(browser, server)
    person.converged()

    def stranger():
        return Stranger(server, person.evaluate("rayset.view.invitation()"))

    show = {"type": "show", "generation": 1, "size": [640, 360], "moving": False,
            "camera": {"position": [0, 0, 9], "direction": [0, 0, -1], "up": [0, 1, 0], "fovy": 40}}
    for wrong in (b"{", b"[]", b"{}", b'{"type": "show"}', b"\xff\xfe", b"[" * 60_000,
                  json.dumps({**show, "file": "/etc/passwd"}).encode()):
        one = stranger()
        one.send(wrong)
        assert one.is_closed(), wrong[:40]
    for size in (1 << 20, 1 << 30):
        one = stranger()
        try:
            one.send(b"x" * (1 << 20), length=size)
        except ConnectionError:
            pass
        assert one.is_closed(), f"a message of {size} bytes"
    one = stranger()
    one.send(b"abc", opcode=2)
    assert one.is_closed(), "a binary message"
    flood = stranger()
    try:
        for _ in range(3000):
            flood.send(b'{"type": "ack", "frame": 1}')
    except ConnectionError:
        pass
    assert flood.is_closed(), "a flood of messages"
    # What is wrong with a scene is said, and the connection stays.
    odd = stranger()
    for changes in ({"style": {"look": "/etc/passwd"}}, {"style": {"opacity": [[1e300, 2], [0, 0]]}}, {"section": {"min": [1e300] * 3, "max": [-1e300] * 3}},
                    {"sun": {"direction": [0, 0, 0], "intensity": -1, "shadow": True}}):
        odd.send(json.dumps({**show, "generation": show["generation"] + 1, "changes": changes}).encode())
        show["generation"] += 1
    assert not odd.is_closed(1)
    # One that reads nothing, and as many as a program may open.
    idle = stranger()
    idle.send(json.dumps(show).encode())
    crowd = []
    for _ in range(1000):
        try:
            crowd.append(socket.create_connection(("127.0.0.1", server.port), timeout=5))
        except OSError:
            break
    drag(person.page, (100, 30))
    person.is_what_render_makes(folder)
    for each in crowd:
        each.close()
    person.well()


@test()
def whoever_knows_the_password_is_let_in(browser, folder):
    points = folder / "points.ply"
    secret = folder / "password"
    secret.write_text("a long sentence\n")
    short = folder / "short"
    short.write_text("1234567\n")
    for options in ([], ["--password-file", str(short)]):
        refused = subprocess.run([PROGRAM, "view", str(points), "--no-open", "--listen", "0.0.0.0", *options], capture_output=True,
                                 text=True, timeout=60)
        assert refused.returncode == 1 and "password" in refused.stderr, refused.stderr
    server = Server(points, folder, options=["--listen", "0.0.0.0", "--password-file", str(secret)])
    page = browser.new_context().new_page()
    page.goto(f"http://127.0.0.1:{server.port}/")
    page.get_by_label("Password").fill("a wrong sentence")
    page.get_by_role("button", name="Enter").click()
    page.get_by_role("alert").wait_for()
    page.screenshot(path=SHOTS / "door.png")
    if AXE:
        debugger = page.context.new_cdp_session(page)
        for scheme in ("dark", "light"):
            page.emulate_media(color_scheme=scheme)
            asked = {"expression": f"{AXE}; axe.run().then((found) => found.violations.filter(({{ impact }}) => "
                     "['serious', 'critical'].includes(impact)).map(({ id }) => id))", "awaitPromise": True, "returnByValue": True}
            serious = debugger.send("Runtime.evaluate", asked)["result"]["value"]
            assert serious == [], f"the door, {scheme}: {serious}"
    time.sleep(0.6)
    page.get_by_label("Password").fill("a long sentence")
    page.get_by_role("button", name="Enter").click()
    page.locator("#status", has_text="complete").wait_for(timeout=PATIENCE)
    server.end()
