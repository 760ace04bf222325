# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What stands in the files for simulators; test_engines.py has simulators read them."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from pendubot_identification.formats.masses import rig_of
from pendubot_identification.formats.robots import mjcf, urdf
from pendubot_identification.model.parameters import BALANCE

RIG = rig_of(replace(BALANCE, Fc1=0.01, Fc2=0.002, J2=0.0003))


def numbers(text):
    return [float(word) for word in text.split()]


def of_mjcf(root):
    """Of each link: where its joint is, centre of mass, mass, inertia, damping, dry friction; the motor's limits."""
    found = []
    for body in root.iter('body'):
        inertial, joint = body.find('inertial'), body.find('joint')
        assert (joint.get('axis'), inertial.get('pos').split()[1:]) == ('0 -1 0', ['0', '0'])
        x, *_ = numbers(body.get('pos', '0 0 0'))
        about = numbers(inertial.get('diaginertia'))[1]
        values = joint.get('damping'), joint.get('frictionloss')
        found.append((x, numbers(inertial.get('pos'))[0], float(inertial.get('mass')), about, *map(float, values)))
    assert [joint.get('armature') for joint in root.iter('joint')] == [None, repr(RIG.parameters.J2)]
    return found, numbers(root.find('actuator/motor').get('ctrlrange'))[1]


def of_urdf(root):
    found = []
    for name, joint in (('link_1', 'shoulder'), ('link_2', 'elbow')):
        inertial, joint = root.find(f"link[@name='{name}']/inertial"), root.find(f"joint[@name='{joint}']")
        assert (joint.find('axis').get('xyz'), joint.find('child').get('link')) == ('0 -1 0', name)
        x, centre = (numbers(each.find('origin').get('xyz'))[0] for each in (joint, inertial))
        values = inertial.find('mass').get('value'), inertial.find('inertia').get('iyy')
        dynamics = joint.find('dynamics').get('damping'), joint.find('dynamics').get('friction')
        found.append((x, centre, *map(float, values), *map(float, dynamics)))
    efforts = [float(limit.get('effort')) for limit in root.iter('limit')]
    assert efforts[1] == 0, 'the elbow has no motor'
    return found, efforts[0]


@pytest.mark.parametrize(('write', 'read'), [(mjcf, of_mjcf), (urdf, of_urdf)])
def test_the_files_hold_every_digit_of_the_rig_whatever_their_comments(write, read):
    first, second, p = RIG.first, RIG.second, RIG.parameters
    root = ElementTree.fromstring(write(RIG, ['a <bag> -- & more ---'], 0.7))
    assert read(root) == (
        [
            (0.0, first.centre, first.mass, first.inertia, p.b1, p.Fc1),
            (first.length, second.centre, second.mass, second.inertia, p.b2, p.Fc2),
        ],
        0.7,
    )
    assert not {'limit', 'effort'} & {each.tag for each in ElementTree.fromstring(write(RIG)).iter()}
