"""Files of MRCLAM in the published layout, made by hand from drives whose truth is known."""

from __future__ import annotations

import gzip

import numpy as np

from ekfslam import geometry as geo
from ekfslam.datasets import mrclam
from ekfslam.datasets.mrclam_files import SWAPPED

EPOCH = 1248272263.25
BARCODES = {1: 5, 2: 14, 3: 41, 6: 72, 7: 27, 11: 18, 17: 61}
PLACES = {6: (3.0, 0.5), 7: (2.5, -0.8), 11: SWAPPED[11], 17: SWAPPED[17]}
TRUE_PLACES = {**PLACES, 11: SWAPPED[17], 17: SWAPPED[11]}
SCALE, LAG, SHIFT = (0.9, 0.95), 0.2, -0.03
HEADER = "# UTIAS Multi-Robot Cooperative Localization and Mapping Dataset\n# Time [s] ...\n"


def write(folder, name, rows, packed=False, formats="%.10f"):
    """A file as they are published: comments, tabs and blanks."""
    text = HEADER + "".join("\t ".join(formats % x for x in row) + " \n" for row in rows)
    path = folder / (name + ".gz" * packed)
    path.write_bytes(gzip.compress(text.encode()) if packed else text.encode())
    return path


def write_world(folder, places=PLACES):
    folder.mkdir(exist_ok=True)
    write(folder, "Barcodes.dat", BARCODES.items(), formats="%d")
    write(folder, "Landmark_Groundtruth.dat", [(s, *xy, 1e-4, 2e-4) for s, xy in places.items()])


def driven(commands, start, times, lag=LAG, scale=SCALE):
    """Poses by going from command to command on circles, one after another."""
    v = w = 0.0
    pose, now, found = np.array(start, dtype=float), times[0], []
    events = [(t + lag, 0, (a, b)) for t, a, b in commands] + [(t, 1, None) for t in times]
    for at, _, told in sorted(events, key=lambda event: event[:2]):
        if at > now:
            turn = w * (at - now)
            if abs(w) > 0:
                radius, h = v / w, pose[2]
                pose += [
                    radius * (np.sin(h + turn) - np.sin(h)),
                    radius * (np.cos(h) - np.cos(h + turn)),
                    turn,
                ]
            else:
                pose += [v * (at - now) * np.cos(pose[2]), v * (at - now) * np.sin(pose[2]), 0.0]
            now = at
        if told is None:
            found.append(pose.copy())
        else:
            v, w = told[0] * scale[0], told[1] * scale[1]
    return np.array(found)


def drive(rng, seconds=20.0, still=1.0):
    """Commands some 15 ms apart, in milliseconds, that change every second and start with rest."""
    stamps = np.round(np.cumsum(rng.uniform(0.010, 0.020, int(seconds / 0.015))), 3)
    changes = np.column_stack([rng.uniform(0, 0.09, 99), rng.uniform(-0.6, 0.6, 99)]).round(3)
    told = changes[stamps.astype(int)]
    told[stamps < still] = 0.0
    return np.column_stack([EPOCH + stamps, told])


def write_robot(folder, robot, commands, sightings, start, truth="Groundtruth", packed=False):
    """A robot that starts somewhere; truth some 16 ms apart from before to behind the commands."""
    times = np.arange(commands[0, 0] - 0.5, commands[-1, 0] + 0.5, 0.016)
    poses = driven(commands, start, times)
    poses[:, 2] = geo.wrap(poses[:, 2])
    write(folder, f"Robot{robot}_Odometry.dat", commands, packed)
    write(folder, f"Robot{robot}_Measurement.dat", sightings, packed)
    if truth:
        write(folder, f"Robot{robot}_{truth}.dat", np.column_stack([times, poses]), packed)
    return np.column_stack([times, poses])


def sighting(pose, time, subject, point):
    """What a robot at a pose sees, stamped late."""
    x, y = geo.to_frame(pose, np.array(point))
    return time - SHIFT, BARCODES[subject], np.hypot(x, y), np.arctan2(y, x)


def sightings_of(commands, start, subjects=(6, 7, 11, 17), seconds=0.37):
    times = np.arange(commands[0, 0] + 1.0, commands[-1, 0] - 0.5, seconds)
    poses = driven(commands, start, np.concatenate([[commands[0, 0]], times]))[1:]
    return [
        sighting(pose, time, subjects[i % len(subjects)], TRUE_PLACES[subjects[i % len(subjects)]])
        for i, (time, pose) in enumerate(zip(times, poses, strict=True))
    ]


def write_set(folder, rng):
    """Set 1 with one robot, number 3."""
    write_world(folder)
    commands = drive(rng)
    write_robot(folder, 3, commands, sightings_of(commands, (0.1, 0.2, 0.3)), (0.1, 0.2, 0.3))
    return folder


def load(folder, part="robot3", **options):
    options = {"v_scale": SCALE[0], "w_scale": SCALE[1], "correlated": 0.0} | options
    return mrclam.load(1, folder, part, **options)


def told(dataset, what):
    return any(what in note for note in dataset.notes)
