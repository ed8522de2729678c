"""The live page in a browser: its runs equal those of `simulate` bit for bit; invalid values, links and laws."""

import json
import socket
import time
from urllib.parse import quote

import pytest
from browser import needs_browser, opened

from railrepro import load_scenario, metrics, tuned
from railrepro.compile import cache
from railrepro.control.registry import CONTROLLERS
from railrepro.export import live
from railrepro.simulation import simulate

pytestmark = [
    needs_browser,
    pytest.mark.skipif(cache.found(cache.PACKAGED) is None, reason="`make live` installs the compiler"),
]
SCORES = (
    "[...document.querySelectorAll('#scores tbody tr')].map(row => [...row.cells].map(cell => cell.innerText.trim()))"
)
MESSAGE = "document.getElementById('message').innerText"


@pytest.fixture(scope="module")
def browser_page(tmp_path_factory):
    """The page with one figure and two controllers, its modules compiled without optimisation."""
    folder = tmp_path_factory.mktemp("live")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "WEBASSEMBLY", tuple("-O0" if flag == "-O2" else flag for flag in cache.WEBASSEMBLY))
        patch.setattr(live, "FIGURES", {"Figure 6": "curve_entry_T3"})
        patch.setattr(live, "SHOWN", ("nmpc", "ndi"))
        found = live.content()
    (folder / "index.html").write_text(live.page(found))
    address = (folder / "index.html").as_uri()
    with opened(address, folder / "browser") as opened_page:
        finished(opened_page)
        yield opened_page, address


@pytest.fixture
def page(browser_page):
    """The page after it was opened anew and its first runs have ended."""
    opened_page, address = browser_page
    opened_page.ask("Page.navigate", url="about:blank")
    opened_page.ask("Page.navigate", url=address)
    finished(opened_page)
    return opened_page


def finished(page, seconds=300.0):
    """Wait for the end of all runs and return the rows of the table of scores by controller."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.2)
        rows = page.evaluated(SCORES)
        if rows and not any("running" in row[-1] for row in rows):
            return {row[0]: row for row in rows}
    raise TimeoutError(str(rows))


def follow(page, link):
    """Change the link of the open page to a dict or a text, and return the link that the page sets then."""
    text = quote(link if isinstance(link, str) else json.dumps(link))
    script = f"""new Promise((then) => {{addEventListener('hashchange', () => then(), {{once: true}});
        location.hash = {json.dumps(text)};}}).then(() => decodeURIComponent(location.hash.slice(1)))"""
    return json.loads(page.evaluated(script))


def press(page, button):
    page.evaluated(f"document.getElementById('{button}').click()")


def run_law(page, law):
    """Write a law into the page and press Run."""
    page.evaluated(f"document.getElementById('law').value = {json.dumps(law)}")
    press(page, "run")


def give(page, text, value):
    """Type a value into the field of a slider."""
    script = f"""{{const sliders = [...document.querySelectorAll('.slider')];
        const field = sliders.find(each => each.innerText.includes({json.dumps(text)})).querySelector('[type=number]');
        field.value = {value}; field.dispatchEvent(new Event('change'));}}"""
    page.evaluated(script)


def error_mm(name):
    """RMSE of a tuned controller on T3 (mm) over the rows that the page has."""
    series = simulate.run(load_scenario("curve_entry_T3"), tuned(name, CONTROLLERS[name].quick)).series
    kept = (series.index % 10 == 0) | (series.index == series.index[-1])
    return f"{1e3 * metrics.rmse(series[kept]):.3f}"


def test_the_committed_values_give_the_committed_run_bit_for_bit(page):
    rows = finished(page)
    assert all("Equal to the committed run." in row[-1] for row in rows.values())
    assert {name: row[1] for name, row in rows.items()} == {"NMPC": error_mm("nmpc"), "NDI": error_mm("ndi")}
    assert page.errors == []


def test_a_changed_value_has_an_effect_is_marked_and_is_in_the_link(page):
    for text, value in (("friction of dry", 0.05), ("mass of the car", 50000), ("lag of", 0.03)):
        give(page, text, value)
        assert finished(page)["NMPC"][1] != error_mm("nmpc")
        press(page, "committed")
    give(page, "poles of NDI", 2)
    rows = finished(page)
    assert float(rows["NDI"][1]) < 1.5 and rows["NMPC"][1] == error_mm("nmpc")
    assert "committed" not in rows["NDI"][-1]
    assert page.evaluated("document.querySelectorAll('.slider.changed').length") == 1
    assert json.loads(page.evaluated("decodeURIComponent(location.hash.slice(1))"))["values"] == {"faster": 2}
    give(page, "amplitude", 1.5)
    assert float(finished(page)["NDI"][1]) < 1.0
    give(page, "speed", 9999)
    assert page.evaluated(MESSAGE) == "speed (km/h): a number from 0.5 up to 450 is needed."


@pytest.mark.parametrize(
    "link",
    [
        *({"values": {key: value}} for key in ("body.mass", "r", "speed_kmh") for value in (-1, None, "1", 1e99)),
        {"values": {"amplitude_mm": 1000}},
        {"values": {"nothing": 1}},
        *({"values": value} for value in (None, 5, [1])),
        {"figure": "constructor"},
        {"setting": "equal"},
        {"shown": ["toString"]},
        {"shown": ["ndi"] * 2},
        {"law": 5},
        {"nothing": 5},
        *("null", "5", "[1]", "{"),
    ],
    ids=str,
)
def test_invalid_parts_of_a_link_are_refused_with_a_sentence(browser_page, link):
    page, _ = browser_page
    before = len(page.errors)
    begin = follow(page, {"shown": ["ndi"]})
    assert page.evaluated(MESSAGE) == ""
    taken = follow(page, {"shown": ["ndi"]} | link if isinstance(link, dict) else link)
    assert page.evaluated(MESSAGE).endswith((" needed.", " cannot be read.", " unknown here.", " of this experiment."))
    assert {key: taken[key] for key in taken if key != "shown"} == {key: begin[key] for key in begin if key != "shown"}
    assert set(taken["shown"]) <= {"nmpc", "ndi"} and "NDI" in [row[0] for row in page.evaluated(SCORES)]
    assert page.errors[before:] == []


def test_a_law_of_a_link_waits_for_run_and_has_no_network(browser_page):
    page, _ = browser_page
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"http://127.0.0.1:{server.getsockname()[1]}/"
        law = f"""memory.asked ??= [fetch("{address}").catch(() => 0), import("{address}").catch(() => 0)]; return 0"""
        follow(page, {"shown": ["own", "ndi"], "law": law})
        give(page, "amplitude", 2)
        assert finished(page)["Law of your own"][-1] == "Waits for Run." and "press Run" in page.evaluated(MESSAGE)
        press(page, "run")
        assert "End of the track." in finished(page)["Law of your own"][-1]
        server.settimeout(0.5)
        with pytest.raises(TimeoutError):
            server.accept()


def test_a_users_law_is_scored_and_its_faults_are_sentences(page):
    for box in ("own", "nmpc", "ndi"):
        page.evaluated(f"document.querySelector('#controllers input[value={box}]').click()")
    assert 0.5 < float(finished(page)["Law of your own"][1]) < 5
    forged = "postMessage({number: 3, block: [Array(15).fill(0)], ended: 'forged'}); return 0"
    for law, message in (
        ("return q.nothing.y", "The law stopped at p = 0.0 m: "),
        ("throw 5", "The law stopped at p = 0.0 m: 5."),
        ("return 1 +", "The law cannot be read: "),
        ("}; nothing.x; {", "The law cannot be read: "),
        ("return q.p > 50 ? NaN : 0", "The law returned NaN at p = 50"),
        ("close(); return 0", "The law gave no torque for 3 s at p = "),
        (forged, "The law returned undefined at p = "),
    ):
        run_law(page, law)
        assert finished(page, 20)["Law of your own"][-1] == "The law failed."
        assert page.evaluated(MESSAGE).startswith(message)


@pytest.mark.parametrize("law", ["while (true) {}", "close(); return 0", "for (;;) postMessage([0, 0])"])
def test_a_law_that_never_returns_leaves_run_and_stop_at_work(browser_page, law):
    page, _ = browser_page
    follow(page, {"shown": ["own"]})
    run_law(page, law)
    run_law(page, "return 3e5 * (q.y_ref - q.y)")
    assert "End of the track." in finished(page, 20)["Law of your own"][-1]
    run_law(page, law)
    press(page, "stop")
    assert finished(page, 20)["Law of your own"][-1] == "Stopped."
