"""The recorded sets: what each is, which module reads it, and where its files come from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ekfslam.datasets.places import VARIABLE, hint, located, there
from ekfslam.datasets.wheel import in_wheel
from ekfslam.errors import FileFormatError


class Recorded(NamedTuple):
    """A recorded set.

    Attributes
    ----------
    description : str
        What it is, in a sentence.
    module, loader : str
        The function that reads it: ``loader(path, **options)``.
    files : tuple of str
        That it needs; each may be compressed (``.gz``).
    folders : tuple of str
        Names that their folder may have in a folder for all sets.
    published : str
        Where its authors publish it. Empty for what comes inside the gtsam wheel.
    number : int
        Which of several sets of one kind; 0 if there is only one.
    parts : tuple of str
        What may follow the name after a slash.
    part_files : tuple of str
        That a part needs besides; ``{part}`` stands for its name, ``{Part}`` for that with a
        capital.
    """

    description: str
    module: str
    files: tuple[str, ...]
    folders: tuple[str, ...] = ()
    published: str = ""
    loader: str = "load"
    number: int = 0
    parts: tuple[str, ...] = ()
    part_files: tuple[str, ...] = ()

    def find(self, name: str, path: str | Path | None = None) -> dict[str, Path]:
        """Its files by name.

        Parameters
        ----------
        name : str
            Of the whole set.
        path : path, optional
            Its file or folder, or a folder for all sets; by default what comes with gtsam, or the
            folder of EKFSLAM_DATA.

        Raises
        ------
        FileFormatError
            If they are not there, or in the folder of another set whose files are called alike.
        """
        if not self.published and path is None:
            return {file: in_wheel(file, name) for file in self.files}
        found = located(name, path, self.folders, self.files)
        folder = found[self.files[0]].parent
        for other, one in RECORDED.items():
            if other != name and one.files == self.files and folder.name in one.folder_names:
                raise FileFormatError(f"{name}: {folder} is a folder of {other}, not of {name}")
        return found

    def given(self, name: str, path: str | Path | None) -> str | Path | None:
        """A path given for several sets as far as it is for this one.

        None for a set inside the gtsam wheel if the folder does not have it.
        """
        mine = path is None or self.published or not Path(path).is_dir() or self.is_here(name, path)
        return path if mine else None

    @property
    def folder_names(self) -> set[str]:
        """Names that the folder itself may have."""
        return {Path(folder).name for folder in self.folders}

    def is_here(self, name: str, path: str | Path | None = None) -> bool:
        """Whether the files of the set, or of a part of it, are there."""
        whole, _, part = name.partition("/")
        try:
            found = self.find(whole, path)
        except FileFormatError:
            return False
        beside = found[self.files[0]]
        besides = _named(self.part_files, part) if part else ()
        return all(each.is_file() for each in found.values()) and all(
            there(beside, file) for file in besides
        )

    def told(self, name: str, path: str | Path | None = None) -> list[tuple[str, str]]:
        """All there is to say: what it is, whether it is here, what is expected and from where.

        Parameters
        ----------
        name : str
            Of the whole set.
        path : path, optional
        """
        try:
            found = self.find(name, path)
            here = f"yes, in {found[self.files[0]].parent}"
        except FileFormatError as error:
            here = f"no: {str(error).removeprefix(f'{name}: ').removesuffix(hint(name))}"
        rows = [("what", self.description), ("here", here)]
        if self.parts:
            missing = [part for part in self.parts if not self.is_here(f"{name}/{part}", path)]
            lost = f"; not here: {', '.join(missing)}" if here.startswith("yes") and missing else ""
            rows.append(("parts", ", ".join(f"{name}/{part}" for part in self.parts) + lost))
        rows.append(("files", f"{', '.join(self.files)}; each as it is or compressed (.gz)"))
        if self.parts:
            besides = ", ".join(_named(self.part_files, self.parts[0]))
            rows.append(("of a part", f"{besides} for {name}/{self.parts[0]}, and so on"))
        if self.published:
            place = f"in the folder of --data or {VARIABLE}, or that folder itself"
            rows.append(("folder", f"{' or '.join(self.folders)}, {place}"))
        wheel = "inside the gtsam package, and read from there unless --data has it"
        rows.append(("published", self.published or wheel))
        return rows


def _named(texts: tuple[str, ...], part: str) -> tuple[str, ...]:
    """Names of the files of a part."""
    return tuple(text.format(part=part, Part=part.capitalize()) for text in texts)


def files_of(name: str, path: str | Path | None = None) -> dict[str, Path]:
    """The files of a recorded set by name.

    Raises
    ------
    FileFormatError
        If they are not there; says what was looked for and where.
    """
    return RECORDED[name].find(name, path)


def _mrclam(number: int) -> Recorded:
    """One of nine sets: five robots among fifteen landmarks."""
    return Recorded(
        f"recorded, indoors: five robots see barcodes on 15 landmarks, and each other; the team, "
        f"or one as in mrclam{number}/robot3; truth by motion capture (Leung and others 2011)",
        "ekfslam.datasets.mrclam",
        ("Barcodes.dat", "Landmark_Groundtruth.dat"),
        (
            f"mrclam/dataset{number}",
            f"dataset{number}",
            f"MRCLAM_Dataset{number}",
            f"mrclam/MRCLAM_Dataset{number}",
            f"MRCLAM{number}",
        ),
        f"asrl.utias.utoronto.ca/datasets/mrclam: MRCLAM_Dataset{number}; beside them the truth, "
        "Robot1_Groundtruth.dat or Robot1_Groundtruth_sparse.dat",
        number=number,
        parts=tuple(f"robot{robot}" for robot in range(1, 6)),
        part_files=("{Part}_Odometry.dat", "{Part}_Measurement.dat"),
    )


RECORDED: Mapping[str, Recorded] = {
    "victoria-park": Recorded(
        "recorded: a car among the trees of a park in Sydney; 6969 poses, 151 landmarks, "
        "association given, no truth (Guivant and Nebot 2001)",
        "ekfslam.datasets.victoria_park",
        ("victoria_park.txt",),
    ),
    "victoria-park-raw": Recorded(
        "recorded: the same run as it came from the car: encoder, steering, trees found in laser "
        "scans, no association; GPS with gaps as truth of the position (Guivant and Nebot 2001)",
        "ekfslam.datasets.victoria_park_raw",
        ("DRS.txt", "GPS.txt", "tree_observations.txt"),
        ("victoria_park",),
        "the Australian Centre for Field Robotics, University of Sydney; the text release of 2003",
    ),
    "plaza1": Recorded(
        "recorded: a mower and ranges to four radio beacons; 9658 poses, 3527 ranges, truth and "
        "association given (Djugash, Hamner and Roth 2009)",
        "ekfslam.datasets.plaza",
        ("Plaza1_.mat",),
        ("plaza",),
        number=1,
    ),
    "plaza2": Recorded(
        "recorded: as plaza1, faster, with a gyro that drifts; 4091 poses, 1816 ranges",
        "ekfslam.datasets.plaza",
        ("Plaza2_.mat",),
        ("plaza",),
        number=2,
    ),
    **{f"mrclam{number}": _mrclam(number) for number in range(1, 10)},
    "lego": Recorded(
        "recorded: a small robot with a laser scanner among six known cylinders; no association, "
        "truth of the position by a camera (Brenner, Leibniz University Hannover, 2012)",
        "ekfslam.datasets.lego",
        (
            "robot4_motors.txt",
            "robot4_scan.txt",
            "robot4_reference.txt",
            "robot_arena_landmarks.txt",
        ),
        ("brenner_lego", "lego"),
        "the course SLAM lectures of Claus Brenner, ikg, Leibniz University Hannover, unit D",
    ),
    "car-park": Recorded(
        "recorded: a car among 15 surveyed reflective poles; steering, laser, no association, "
        "truth of the position by GPS (Nieto, Guivant and Nebot, University of Sydney)",
        "ekfslam.datasets.car_park",
        ("data_set.mat", "beac_juan3.mat"),
        ("car_park",),
        "the Australian Centre for Field Robotics, University of Sydney, for the SLAM summer "
        "schools of 2002 to 2006",
    ),
    "dlr": Recorded(
        "recorded: a robot in an office, a camera and 576 discs on the floor, associations made by "
        "hand, no truth (Kurlbaum and Frese 2009)",
        "ekfslam.datasets.dlr",
        ("map.circles",),
        ("dlr_spatial_cognition", "dlr"),
        "openslam.org/slom: example/dlr/map.circles",
    ),
    "city-trees": Recorded(
        "simulated by others: 10,000 poses in a grid of streets, 100 trees, known association, "
        "noise-free truth; further draws as in city-trees/mc0 (distributed with iSAM, Kaess, "
        "Ranganathan and Dellaert 2008)",
        "ekfslam.datasets.city_trees",
        ("cityTrees10000.txt", "cityTrees10000_groundtruth.txt"),
        ("city_trees10000",),
        "the iSAM distribution (Kaess), data/cityTrees10000.txt",
        parts=tuple(f"mc{draw}" for draw in range(10)),
        part_files=("cityTrees10000_{part}.txt",),
    ),
    "freiburg-course": Recorded(
        "simulated by others: a small world with 9 landmarks, known association, their truth "
        "(course Robot Mapping, University of Freiburg)",
        "ekfslam.datasets.freiburg_course",
        ("sensor_data.dat", "world.dat"),
        ("freiburg_course",),
        "the course Robot Mapping of C. Stachniss, University of Freiburg: EKF SLAM exercise",
    ),
}
