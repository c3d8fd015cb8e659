"""A mass-spring-damper network as a MuJoCo model: point masses on two slides, springs as tendons.

MuJoCo's tendons pull and damp along themselves only, so a network has its like there where damping
is axial and k_s is zero.
"""

from xml.etree import ElementTree

import mujoco
import numpy as np

PLANE = {'x': '1 0 0', 'y': '0 1 0'}
INERTIA = '1 1 1'  # of masses that never turn, but MuJoCo asks for one
LEFT_OUT = ('constraint', 'contact', 'autoreset')


def mujoco_model(network, gravity, step, integrator='RK4'):
    """Return the model; its qpos is the configuration q [m], its qvel q̇ [m/s].

    Args:
        network: a `MassSpringNetwork`.
        gravity: a `Gravity`.
        step: time step [s].
        integrator: one of MuJoCo's.

    Raises:
        ValueError: the network has no like in MuJoCo.
    """
    if network.damping_kind != 'axial' or network.background_stiffness != 0.0:
        raise ValueError(
            'network: expected axial damping and a background stiffness of 0, got '
            f'{network.damping_kind} and {network.background_stiffness}'
        )
    root = ElementTree.Element('mujoco')
    option = ElementTree.SubElement(
        root,
        'option',
        timestep=_text(step),
        integrator=integrator,
        gravity=_text(*gravity.vector, 0.0),
    )
    ElementTree.SubElement(option, 'flag', dict.fromkeys(LEFT_OUT, 'disable'))
    _add_masses(ElementTree.SubElement(root, 'worldbody'), network)
    _add_springs(ElementTree.SubElement(root, 'tendon'), network)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding='unicode'))


def _add_masses(world, network):
    mobile = set(network.mobile.tolist())
    for number, (place, mass) in enumerate(zip(network.rest_position, network.mass, strict=True)):
        body = world
        if number in mobile:
            body = ElementTree.SubElement(world, 'body', pos=_text(*place, 0.0))
            for coordinate, (axis, direction) in zip(place, PLANE.items(), strict=True):
                name = f'{number}/{axis}'
                ElementTree.SubElement(
                    body, 'joint', name=name, type='slide', axis=direction, ref=_text(coordinate)
                )
            ElementTree.SubElement(
                body, 'inertial', pos='0 0 0', mass=_text(mass), diaginertia=INERTIA
            )
        position = '0 0 0' if number in mobile else _text(*place, 0.0)
        ElementTree.SubElement(body, 'site', name=str(number), pos=position)


def _add_springs(tendons, network):
    for ends, stiffness, length, damping in zip(
        network.springs, network.stiffness, network.rest_length, network.damping, strict=True
    ):
        tendon = ElementTree.SubElement(
            tendons,
            'spatial',
            stiffness=_text(stiffness),
            springlength=_text(length),
            damping=_text(damping),
        )
        for end in ends:
            ElementTree.SubElement(tendon, 'site', site=str(end))


def _text(*numbers):
    return ' '.join(np.format_float_positional(number, unique=True) for number in numbers)


def mujoco_acceleration(model, data, configuration, velocity, force):
    """Return q̈ [m/s²] of the model at a state under an external force [N]."""
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = configuration, velocity, force
    mujoco.mj_forward(model, data)
    return data.qacc.copy()
