# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Results of a few seconds of the sample bag."""

import functools
from dataclasses import asdict

import yaml

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import CRITERIA, Settings
from pendubot_identification.recordings.bag_reader import read_trajectory
from pendubot_identification.results.computation import assemble_result
from pendubot_identification.results.result import Result, structured
from pendubot_identification.results.result import plain as plain_of
from pendubot_identification.trajectories.trajectory import Source
from test.conftest import SAMPLE

SOURCE = Source('swing@0:4', 'training', 400, 3.99, '0' * 64, True)


@functools.cache
def swing():
    return read_trajectory(SAMPLE).trajectory


@functools.cache
def identified(criteria=CRITERIA, model='viscous', optimizer='lsq', hold='zero', validate=True):
    """Return the identification of the first 4 s, validated on the next 4 s or by blocks of time."""
    validation = [swing()[400:800]] if validate else []
    return identify([swing()[:400]], validation, Settings(criteria, model, optimizer, hold=hold))


def made(*args, **settings):
    return assemble_result(identified(*args, **settings), [SOURCE])


def plain(*args, **settings):
    """Return a fresh copy of the result as plain data."""
    return plain_of(made(*args, **settings))


def result(data):
    return structured(Result, data, 'test')


def write(path, data):
    path.write_text(yaml.safe_dump(data, sort_keys=False))


def written(path, parameters):
    """Write parameters to a result file as by hand; return its path."""
    write(path, {'schema': 1, 'parameters': {name: {'value': value} for name, value in asdict(parameters).items()}})
    return path
