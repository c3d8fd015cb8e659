"""Activations and their derivatives are torch's."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.autoencoder.activations import ACTIVATIONS

MODULES = {'elu': torch.nn.ELU(), 'silu': torch.nn.SiLU()}
INPUTS = st.floats(-40, 40).filter(lambda z: z != 0)  # ELU's second derivative jumps at zero


@pytest.mark.parametrize('name', ACTIVATIONS)
@given(st.lists(INPUTS, min_size=1, max_size=10))
def test_value_and_derivatives(name, inputs):
    ours = ACTIVATIONS[name]
    z = torch.tensor(inputs, dtype=torch.float64, requires_grad=True)
    value = MODULES[name](z)
    (first,) = torch.autograd.grad(value.sum(), z, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), z)
    at = np.array(inputs)
    for mine, theirs in (
        (ours.value(at), value),
        (ours.first_derivative(at), first),
        (ours.second_derivative(at), second),
    ):
        np.testing.assert_allclose(mine, theirs.detach().numpy(), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize('name', ACTIVATIONS)
def test_large_inputs_stay_finite(name):
    z = np.array([-1e4, -800.0, 0.0, 800.0, 1e4])
    for function in ACTIVATIONS[name]:
        assert np.isfinite(function(z)).all()
