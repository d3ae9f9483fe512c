"""The page of a comparison or a campaign: all of its tables, nothing loaded, nobody's markup."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import campaigns
import numpy as np
import pandas as pd
import pytest
from reported import FOUR, MESSAGE, NASTY, Nasty, Page, compared, short
from scipy import stats

from ekfslam.errors import FileFormatError, InputError
from ekfslam.evaluation import tables
from ekfslam.evaluation.statistics import share_interval
from ekfslam.experiments import compare, read_campaign, run_campaign
from ekfslam.geometry import ellipse
from ekfslam.plots.style import looks
from ekfslam.report import write_report
from ekfslam.report.maps import STOPS, UNITS
from ekfslam.report.words import digits, interval, plus_minus, seeds_in_words

ROOT = Path(__file__).parents[1]
LIMIT = 5e6  # bytes


def page_of(folder, tmp_path):
    """The page of a folder, as text and read."""
    text = write_report(folder, tmp_path / "page.html").read_text(encoding="utf-8")
    return text, Page(text)


@pytest.fixture(scope="module")
def comparison():
    return compared()


@pytest.fixture(scope="module")
def folder(comparison, tmp_path_factory):
    place = tmp_path_factory.mktemp("compared")
    comparison.save(place, figures=False)
    return place


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    place = tmp_path_factory.mktemp("campaign")
    source = campaigns.SMALL | {"estimators": ["ekf", "dead-reckoning", "campaigns:Broken"]}
    source["compare"] = {"baseline": "ekf", "metrics": ["final_heading_sigma_rad"]}
    run_campaign(source | {"seeds": 8, "name": NASTY}, place)
    return place


@pytest.fixture(scope="module")
def compared_page(folder, tmp_path_factory):
    """Text and content of the comparison's page."""
    return page_of(folder, tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def campaign_page(campaign, tmp_path_factory):
    """Text and content of the campaign's page."""
    return page_of(campaign, tmp_path_factory.mktemp("page"))


# Tables ------------------------------------------------------------------------------------------


def assert_complete(found, table):
    """Every filled column and every row, every digit of a number."""
    filled = [name for name in table if table[name].notna().any()]
    assert found.headings == filled
    assert len(found.rows) == len(table)
    for cells, (_, row) in zip(found.rows, table.iterrows(), strict=True):
        for (text, value), name, numeric in zip(cells, filled, found.numeric, strict=True):
            assert numeric == pd.api.types.is_numeric_dtype(table[name].dtype)
            if pd.isna(row[name]):
                assert (text, value or "") == ("", "")
            elif numeric:
                assert float(value) == float(row[name])
                assert float(text) == pytest.approx(float(row[name]), rel=5.1e-3)
            else:
                assert text == row[name]


def test_the_table_of_a_comparison_is_whole(folder, compared_page):
    _, page = compared_page
    summary = tables.read_csv("summary", folder / "summary.csv")
    assert_complete(page.tables["All columns of the table summary"], summary)


def test_what_is_read_most_stands_by_dataset(folder, compared_page):
    _, page = compared_page
    summary = tables.read_csv("summary", folder / "summary.csv")
    for dataset, title in (("cloister", "cloister, seed 1"), (NASTY, f"{NASTY}, seed 1")):
        found, rows = page.tables[title], summary[summary["dataset"] == dataset]
        at = found.headings.index("ATE [m]")
        values = [float(row[at][1] or "nan") for row in found.rows]
        np.testing.assert_array_equal(values, rows["ate_position_rmse_m"])
        assert [row[0][0] for row in found.rows] == list(rows["estimator"])
        assert found.headings[-1] == "message"
        assert MESSAGE in found.rows[-1][-1][0]


def test_the_tables_of_a_campaign_are_whole(campaign, campaign_page):
    results = read_campaign(campaign)
    _, page = campaign_page
    assert_complete(page.tables["All columns of the table summary"], results.summary)
    assert_complete(page.tables["All columns of the table pairs"], results.pairs)
    odd = page.tables["Runs whose status is not ok"]
    assert [[cell[0] for cell in row][1:4] for row in odd.rows] == 2 * [
        ["Broken", "failed", "1, 3, 5, 7"]
    ]


# Safety ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["compared_page", "campaign_page"])
def test_nothing_is_loaded_and_nothing_runs_but_the_own_script(which, request):
    text, page = request.getfixturevalue(which)
    named = re.sub(r'http-equiv|"http://www.w3.org/2000/svg"', "", text)  # loads nothing
    assert "http" not in named
    for tag, attributes in page.tags:
        assert tag not in (
            "img",
            "iframe",
            "object",
            "embed",
            "base",
            "form",
            "audio",
            "video",
            "b",
        )
        assert "src" not in attributes
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("href", "xlink:href"):
            assert (attributes.get(name) or "#")[0] == "#" or (tag, attributes[name]) == (
                "link",
                "data:,",
            )
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert scripts[:-1] == [{"type": "application/json"}] * len(page.maps)
    assert scripts[-1] == {}
    assert not re.search(r"url\((?!#)|@import", text)


def test_the_policy_names_the_script_that_is_there(compared_page):
    text, _ = compared_page
    script = text.rpartition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.split("; ")[0] == "default-src 'none'"
    assert f"script-src 'sha256-{digest}'" in policy


def test_names_stay_what_they_are(compared_page, campaign_page):
    """Also in figures, where a dollar is no formula."""
    _, page = compared_page
    assert NASTY in page.of("h1")[0]
    assert f"{NASTY}, seed 1" in page.of("h3")
    assert any(text.startswith(NASTY) for text in page.of("text"))
    _, page = campaign_page
    assert page.of("h1") == [NASTY]
    assert any(text.startswith(NASTY) for text in page.of("text"))


def test_no_estimator_is_run_again(comparison, tmp_path):
    comparison.save(tmp_path / "few", figures=False, kept=["summary"])
    code = (
        "import sys; from ekfslam.report import write_report; write_report(*sys.argv[1:]); "
        "assert not {'gtsam', 'baselines', 'ekfslam.filters'} & set(sys.modules)"
    )
    out = tmp_path / "page.html"
    run = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "few", out], check=False, capture_output=True
    )
    assert run.returncode == 0, run.stderr


# Findings ----------------------------------------------------------------------------------------


def told(page):
    return page.of("li")


def side(value, low, high):
    return "above" if value > high else "below" if value < low else "inside"


def test_findings_of_a_comparison_are_those_of_its_tables(comparison, compared_page):
    _, page = compared_page
    summary, said = comparison.summary, "\n".join(told(page))
    rows = summary[summary["dataset"] == "cloister"].set_index(["estimator", "series"])
    online = rows.xs("online", level="series")["ate_position_rmse_m"].sort_values()
    words = [f"{name} {digits(value)} m" for name, value in online.items()]
    assert f"online: {', '.join(words[:-1])} and {words[-1]}" in said
    low, high = stats.chi2.ppf([0.025, 0.975], 3)
    for (name, series), value in rows["nees_pose_final"].dropna().items():
        called = f"{name} ({series})" if name == "gtsam-isam2" else name
        placed = side(value, low, high)
        assert re.search(rf"{placed} \[0.216, 9.35\]: .*{re.escape(called)} {value:.3g}\b", said)
    gap = rows.loc[("ekf", "online")]
    assert f"ekf: its last position is {digits(gap['gap_final_position_m'])} m away" in said
    assert f"sigma of the last position is {digits(gap['sigma_ratio_position'])} times" in said
    assert "gtsam-batch: its last position" not in said
    assert f"{Nasty.name} is failed: RuntimeError: {MESSAGE}" in said


def test_nis_is_held_against_the_interval_of_all_its_innovations(comparison, compared_page):
    _, page = compared_page
    seen = comparison.innovations
    seen = seen[(seen["dataset"] == "cloister") & (seen["estimator"] == "ekf")]
    dof = seen.loc[seen["nis"].notna(), "dof"].sum()
    low, high = stats.chi2.ppf([0.025, 0.975], dof) / dof
    row = comparison.summary.iloc[0]
    assert (row["dataset"], row["estimator"]) == ("cloister", "ekf")
    value = row["nis_per_dof"]
    assert f"{side(value, low, high)} [{low:.4g}, {high:.4g}]: ekf {value:.4g}" in told(page)


def test_findings_of_a_campaign_are_those_of_its_tables(campaign, campaign_page):
    results = read_campaign(campaign)
    _, page = campaign_page
    said = told(page)
    for _, row in results.summary.iterrows():
        if row["run_nees_pose_se"] > 0:
            mean, error, count = (
                row["run_nees_pose_mean"],
                row["run_nees_pose_se"],
                row["nees_runs"],
            )
            low, high = stats.t.interval(0.95, count - 1, mean, error)
            placed = "above 3" if low > 3 else "below 3" if high < 3 else "3 is inside"
            words = f"{row['estimator']} {digits(mean)} ± {error:.2g}"
            if low < 0:
                placed = "no interval"
            else:
                words += f" [{low:.3g}, {high:.3g}]"
            assert any(line.startswith(placed) and words in line for line in said)
        low, high = row["final_nees_low_95"], row["final_nees_high_95"]
        value = row["final_nees_pose_mean"]
        start = f"{side(value, low, high)}"
        assert any(
            line.startswith(start) and f"{row['estimator']} {value:.3g}" in line for line in said
        )
    seen = results.pairs[results.pairs["better"].notna()]
    assert len(seen)
    for verdict in seen["verdict"]:
        assert verdict in said
    few = results.pairs[results.pairs["verdict"].str.startswith("too few pairs to tell")]
    rest = len(results.pairs) > len(seen) + len(few)  # too few seeds are no verdict
    assert rest == ("On the same seeds nobody is seen to be better between" in said)
    assert "Fewer than 6 seeds with a number of both, too few to tell" in said
    assert "Without an estimate, since it raised an error: Broken at 4 seeds." in said


def test_an_interval_around_3_is_told_from_both_sides(campaign, tmp_path):
    """Means and errors set by hand, in a folder that holds the CSVs alone."""
    place = tmp_path / "csv"
    place.mkdir()
    results = read_campaign(campaign)
    names = ["low", "fair", "high", "wild"]
    config = dict(results.config, estimators={name: name for name in names})
    (place / "config.json").write_text(json.dumps(config))
    summary = results.summary.iloc[[0, 1, 2, 2]].copy()
    summary["estimator"] = names
    summary["run_nees_pose_mean"] = [2.0, 3.2, 4.0, 1085.0]
    summary["run_nees_pose_se"] = [0.3, 0.3, 0.3, 613.0]
    summary["nees_runs"] = summary["runs"] = 101
    summary["diverged"] = [0, 4, 101, 15]
    summary.to_csv(place / "summary.csv", index=False)
    results.pairs.iloc[:0].to_csv(place / "pairs.csv", index=False)
    results.nees_over_time.iloc[:0].to_csv(place / "nees_over_time.csv", index=False)
    _, page = page_of(place, tmp_path)
    said = told(page)
    assert "above 3: high 4 ± 0.3 [3.4, 4.6]" in said
    assert "3 is inside: fair 3.2 ± 0.3 [2.6, 3.8]" in said
    assert "below 3: low 2 ± 0.3 [1.4, 2.6]" in said
    assert any(re.fullmatch("no interval.* below 0.*: wild 1085 ± 610", line) for line in said)
    assert "none of 101 (at most 3.59 %): low" in said
    assert "fair: 4 of 101 (3.96 %, 1.09 % to 9.83 %)" in said
    assert "Statistics are those of the CSV files: the runs themselves are not here." in said


def test_numbers_are_read_without_powers_of_ten():
    assert plus_minus(4514.0, 1883.0) == "4514 ± 1900"
    assert interval(-132.4, 8253.0) == "[-132, 8250]"
    assert plus_minus(5.61e8, 4.84e8) == "5.61e+08 ± 4.8e+08"


def test_the_configuration_has_numbers_on_one_line_and_is_the_same(campaign, campaign_page):
    _, page = campaign_page
    (kept,) = page.of("pre")
    assert json.loads(kept) == json.loads((campaign / "config.json").read_text())
    assert '"seeds": [0, 1, 2, 3, 4, 5, 6, 7]' in kept


@pytest.mark.parametrize(("count", "of"), [(0, 1), (0, 50), (3, 50), (50, 50), (1, 2)])
def test_interval_of_a_share(count, of):
    exact = stats.binomtest(count, of).proportion_ci(0.95, method="exact")
    np.testing.assert_allclose(share_interval(count, of), [exact.low, exact.high], atol=1e-12)


def test_an_unfinished_campaign_says_so(campaign, tmp_path):
    place = tmp_path / "half"
    shutil.copytree(campaign, place)
    for path in sorted((place / "runs").iterdir())[::2]:
        path.unlink()
    done, cells = read_campaign(place).cells
    _, page = page_of(place, tmp_path)
    assert 0 < done < cells
    assert f"Unfinished: {done} of {cells} cells are done, and this is what they say." in told(page)


def test_seeds_in_words():
    assert seeds_in_words([5, 0, 1, 2, 9, 10]) == "0 to 2, 5, 9 to 10"


# The map -----------------------------------------------------------------------------------------


def test_the_map_holds_what_the_tables_hold(comparison, compared_page):
    _, page = compared_page
    data = page.maps[0]
    assert max(data["size"]) == UNITS
    track = next(each for each in data["tracks"] if each["label"] == "ekf (online)")
    rows = comparison.trajectories
    rows = rows[(rows["dataset"] == "cloister") & (rows["estimator"] == "ekf")]
    assert data["steps"] == list(rows["step"])
    xy = np.reshape(track["xy"], (-1, 2)) / data["unit"]
    x, y = data["origin"][0] + xy[:, 0], data["origin"][1] - xy[:, 1]
    within = 0.51 / data["unit"]  # whole units
    np.testing.assert_allclose(x, rows["x_m"], atol=within)
    np.testing.assert_allclose(y, rows["y_m"], atol=within)
    np.testing.assert_allclose(track["error"], rows["error_position_m"], atol=5.1e-4)
    assert track["color"] == looks(FOUR)["ekf"].color.lower()[1:]


def test_ellipses_are_those_of_the_covariances(comparison, compared_page):
    """Points of an independent outline lie on the ellipse that is drawn."""
    _, page = compared_page
    data = page.maps[0]
    drawn = np.reshape(data["maps"][0]["ellipses"], (-1, 5))
    rows = comparison.landmarks
    rows = rows[(rows["dataset"] == "cloister") & (rows["estimator"] == "ekf")]
    assert len(drawn) == len(rows) > 3
    for (x, y, a, b, deg), (_, row) in zip(drawn, rows.iterrows(), strict=True):
        covariance = [[row["cov_xx"], row["cov_xy"]], [row["cov_xy"], row["cov_yy"]]]
        outline = ellipse([row["x_m"], row["y_m"]], covariance)
        u = (outline[:, 0] - data["origin"][0]) * data["unit"] - x
        v = (data["origin"][1] - outline[:, 1]) * data["unit"] - y
        turn = np.radians(deg)  # clockwise, as SVG turns
        along = u * np.cos(turn) + v * np.sin(turn)
        across = -u * np.sin(turn) + v * np.cos(turn)
        radius = np.hypot(along / a, across / b)
        np.testing.assert_allclose(radius, 1.0, atol=0.2 / b + 1e-3)


def test_sightings_are_those_of_the_innovations(comparison, compared_page):
    _, page = compared_page
    data = page.maps[0]
    seen = comparison.innovations
    seen = seen[(seen["dataset"] == "cloister") & (seen["estimator"] == "ekf")].dropna(
        subset="landmark"
    )
    expected = seen.groupby("step")["landmark"].nunique()
    counts = pd.Series([len(each) for each in data["sightings"][0]], data["steps"])
    assert counts[counts > 0].to_dict() == expected.to_dict()


def test_smoothed_series_are_shown_at_first(compared_page):
    _, page = compared_page
    on = {each["label"]: each["on"] for each in page.maps[0]["maps"]}
    assert on == {
        "ekf (online)": True,
        "gtsam-batch (smoothed)": True,
        "gtsam-isam2 (online)": False,
        "gtsam-isam2 (smoothed)": True,
        "dead-reckoning (online)": True,
    }


def test_a_campaign_has_no_map_and_says_so(campaign, campaign_page):
    _, page = campaign_page
    assert page.maps == []
    assert "A campaign keeps no poses, so that there is no map." in told(page)


# Forms of a folder -------------------------------------------------------------------------------


def test_csv_and_parquet_make_the_same_page(comparison, compared_page, tmp_path):
    """Which also says that the same tables make the same page."""
    comparison.save(tmp_path / "parquet", figures=False, form="parquet")
    assert page_of(tmp_path / "parquet", tmp_path)[0] == compared_page[0]


def test_thinned_tables(comparison, tmp_path):
    comparison.save(tmp_path / "thin", figures=False, every=7)
    _, page = page_of(tmp_path / "thin", tmp_path)
    assert page.maps[0]["steps"] == [*range(0, 60, 7), 60]
    said = told(page)
    assert any("every 7th step is kept" in line for line in said)
    assert any("NIS per degree of freedom, expected 1: ekf" in line for line in said)
    assert not any(
        "the 95 % interval that holds if the stated noise" in line and "NIS" in line
        for line in said
    )


def test_without_tables_of_steps(comparison, tmp_path):
    comparison.save(tmp_path / "few", figures=False, kept=["summary"])
    _, page = page_of(tmp_path / "few", tmp_path)
    assert page.maps == []
    assert "Without trajectories there are neither maps nor figures." in told(page)
    assert len(page.tables["All columns of the table summary"].rows) == len(comparison.summary)


def test_a_dataset_on_which_everybody_failed(tmp_path):
    compare(short("cloister", 5), Nasty()).save(tmp_path / "none", figures=False)
    _, page = page_of(tmp_path / "none", tmp_path)
    assert any(f"{Nasty.name} is failed: RuntimeError: {MESSAGE}" in line for line in told(page))
    assert page.maps == []


def test_several_robots(tmp_path):
    compare("team", ["ekf", "dead-reckoning"]).save(tmp_path / "team", figures=False)
    _, page = page_of(tmp_path / "team", tmp_path)
    robots = {each["robot"] for each in page.maps[0]["tracks"]}
    assert len(robots) == 3
    assert len(page.maps[0]["truth"]) == 3
    assert len({each["map"] for each in page.maps[0]["tracks"]}) == 2


def damaged(folder, tmp_path, name, change):
    place = tmp_path / "damaged"
    shutil.copytree(folder, place)
    text = (place / name).read_text()
    (place / name).write_text(change(text))
    return place


def with_word(text):
    """The position of the third row is a word."""
    lines = text.split("\n")
    cells = lines[3].split(",")
    cells[lines[0].split(",").index("x_m")] = "here"
    lines[3] = ",".join(cells)
    return "\n".join(lines)


DAMAGES = {
    "a word": ("trajectories.csv", with_word, r"trajectories.csv, line 4: x_m cannot be 'here'"),
    "cut short": (
        "landmarks.csv",
        lambda t: t[:-9],
        r"landmarks.csv, line \d+: .* middle of a line",
    ),
    "more cells": (
        "summary.csv",
        lambda t: t + ",,\n" * 60 + "," * 99 + "\n",
        r"summary.csv: .* line \d+",
    ),
    "older": (
        "summary.csv",
        lambda t: t.replace("time_per_step_mean_us", "x", 1),
        "line 1: .* time_per_step_mean_us",
    ),
    "no JSON": ("config.json", lambda t: t[: len(t) // 2], r"config.json, line \d+: damaged"),
    "other JSON": ("config.json", lambda t: "{}", "neither of a comparison nor of a campaign"),
    "a list": ("config.json", lambda t: "[]", "config.json, line 1: damaged"),
    "empty": ("summary.csv", lambda t: "", "summary.csv: damaged"),
}


@pytest.mark.parametrize("what", DAMAGES)
def test_damage_is_told_with_its_place(folder, tmp_path, what):
    name, change, message = DAMAGES[what]
    place = damaged(folder, tmp_path, name, change)
    with pytest.raises(FileFormatError, match=message) as caught:
        write_report(place)
    assert "\n" not in str(caught.value)
    assert not (place / "report.html").exists()


def test_damage_of_a_campaign(campaign, tmp_path):
    place = damaged(campaign, tmp_path, "config.json", lambda t: t.replace('"hash"', '"mash"'))
    with pytest.raises(FileFormatError, match="neither of a comparison nor of a campaign"):
        write_report(place)


def test_a_line_is_counted_past_messages_of_several(folder, tmp_path):
    place = damaged(folder, tmp_path, "summary.csv", lambda text: text)
    summary = pd.read_csv(place / "summary.csv", dtype="string")
    summary.loc[0, "message"] = "one\ntwo\nthree"
    summary.loc[2, "steps"] = "many"
    summary.to_csv(place / "summary.csv", index=False)
    lines = (place / "summary.csv").read_text().split("\n")
    expected = 1 + next(i for i, line in enumerate(lines) if ",many," in line)
    with pytest.raises(
        FileFormatError, match=f"summary.csv, line {expected}: steps cannot be 'many'"
    ):
        write_report(place)


@pytest.mark.parametrize("make", [lambda p: None, lambda p: p.mkdir(), lambda p: p.write_text("x")])
def test_no_folder_of_results(tmp_path, make):
    make(tmp_path / "it")
    with pytest.raises(FileFormatError, match="it: "):
        write_report(tmp_path / "it")


def test_a_page_that_cannot_be_written(folder, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        write_report(folder, tmp_path / "nowhere" / "page.html")


# Sizes -------------------------------------------------------------------------------------------


def test_a_campaign_of_a_hundred_runs_is_small(tmp_path):
    path = write_report(ROOT / "results" / "hard-loop", tmp_path / "page.html")
    assert path.stat().st_size < LIMIT
    assert "100: 0 to 99" in Page(path.read_text(encoding="utf-8")).of("dd")


def large(tmp_path, poses=10_000, count=5000):
    """Tables of a long run with a large map, of two estimators."""
    rng = np.random.default_rng(1)
    steps, names = np.arange(poses), ("ekf", "ekf-compressed")
    truth = 100.0 * np.column_stack([np.cos(steps / 900), np.sin(steps / 1300)])
    marks = rng.uniform(-120, 120, (count, 2))
    base = {"dataset": "large", "seed": 1, "robot": "robot", "series": "online"}
    parts: dict[str, list[pd.DataFrame]] = {"trajectories": [], "landmarks": [], "summary": []}
    for name in names:
        error = 0.3 * rng.standard_normal((poses, 2))
        both = {f"error_{axis}_m": error[:, i] for i, axis in enumerate("xy")}
        known = {f"true_{axis}_m": truth[:, i] for i, axis in enumerate("xy")}
        own = {f"{axis}_m": truth[:, i] + error[:, i] for i, axis in enumerate("xy")}
        more = {"step": steps, "time_s": 1.0 * steps, "cov_xx": 0.1, "cov_xy": 0.01, "cov_yy": 0.1}
        more |= {"nees": rng.chisquare(3, poses), "nis": rng.chisquare(9, poses), "nis_dof": 9}
        more |= {"error_position_m": np.hypot(*error.T), "time_step_s": rng.uniform(1, 9, poses)}
        parts["trajectories"].append(
            tables.filled(
                "trajectories", base | {"estimator": name} | both | known | own | more, poses
            )
        )
        seen = marks + 0.2 * rng.standard_normal((count, 2))
        points = {"landmark": np.arange(count), "x_m": seen[:, 0], "y_m": seen[:, 1]}
        points |= {"true_x_m": marks[:, 0], "true_y_m": marks[:, 1]}
        spread = {"cov_xx": rng.uniform(0.1, 0.2, count), "cov_xy": 0.02, "cov_yy": 0.1}
        parts["landmarks"].append(
            tables.filled("landmarks", base | {"estimator": name} | points | spread, count)
        )
        parts["summary"].append(
            tables.filled("summary", base | {"estimator": name, "status": "ok", "steps": poses}, 1)
        )
    tmp_path.mkdir()
    for table, rows in parts.items():
        pd.concat(rows).to_parquet(tmp_path / f"{table}.parquet", index=False)
    config = {"datasets": {"large": {}}, "estimators": {name: {} for name in names}}
    (tmp_path / "config.json").write_text(json.dumps(config))
    return tmp_path


def test_a_long_run_on_a_large_map_is_a_few_megabytes(tmp_path):
    text, page = page_of(large(tmp_path / "large"), tmp_path)
    assert len(text.encode()) < LIMIT
    data = page.maps[0]
    assert len(data["steps"]) <= STOPS
    assert (data["steps"][0], data["steps"][-1]) == (0, 9999)
    assert [len(each["xy"]) for each in data["maps"]] == 2 * [10_000]
    assert [len(each["ellipses"]) for each in data["maps"]] == 2 * [5000]
    about = " ".join(page.of("p"))
    assert f"{len(data['steps'])} of 10000 poses are shown" in about
    assert "the largest ellipses are shown, at most 1000" in about


# The command -------------------------------------------------------------------------------------


def test_the_command(run_command, campaign, tmp_path):
    shown = run_command("report", campaign, "--out", tmp_path / "page.html")
    assert (shown.status, shown.err) == (0, "")
    assert re.fullmatch(rf"{re.escape(str(tmp_path))}/page.html: [\d.]+ MB\n", shown.out)
    refused = run_command("report", tmp_path)
    assert refused.status == 2
    assert "no results are kept here" in refused.err
    assert refused.err.count("\n") == 1
