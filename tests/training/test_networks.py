"""One network for all joints."""

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box

from vergence.controllers.networks.inputs import Inputs
from vergence.models import load_head
from vergence.training.networks import JointwisePolicy


@pytest.fixture
def inputs() -> Inputs:
    return Inputs("to_go", load_head("simulated"))


def make(inputs: Inputs) -> JointwisePolicy:
    torch.manual_seed(0)
    policy = JointwisePolicy(
        Box(-1.0, 1.0, (inputs.size,), np.float32),
        Box(-1.0, 1.0, (4,), np.float32),
        lambda _remaining: 1e-3,
        net_arch=[16, 8],
        by_joint=inputs.by_joint.tolist(),
    )
    with torch.no_grad():
        policy.action_net.out.weight.mul_(100.0)  # an untrained policy says next to nothing
    return policy


def some(inputs: Inputs) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (50, inputs.size))).float()


def mean(policy: JointwisePolicy, seen: torch.Tensor) -> torch.Tensor:
    return policy.get_distribution(seen).distribution.mean


def test_joints_that_see_the_same_do_the_same(inputs) -> None:
    policy, seen = make(inputs), some(inputs)
    order = [2, 3, 1, 0]
    swapped = seen.clone()
    swapped[:, inputs.by_joint.ravel()] = seen[:, inputs.by_joint[order].ravel()]
    assert torch.allclose(mean(policy, swapped), mean(policy, seen)[:, order], atol=1e-6)
    assert mean(policy, seen).std() > 0.01


def test_a_joint_sees_its_own_numbers_alone(inputs) -> None:
    policy, seen = make(inputs), some(inputs)
    other = seen.clone()
    other[:, inputs.by_joint[3]] = 0.0
    assert torch.equal(mean(policy, other)[:, :3], mean(policy, seen)[:, :3])
    assert not torch.allclose(mean(policy, other)[:, 3], mean(policy, seen)[:, 3], atol=1e-3)


def test_all_weights_are_trained(inputs) -> None:
    policy, seen = make(inputs), some(inputs)
    trained = {id(p) for group in policy.optimizer.param_groups for p in group["params"]}
    assert trained == {id(p) for p in policy.parameters()}
    values, likelihood, _entropy = policy.evaluate_actions(seen, mean(policy, seen).detach() + 0.5)
    (values.sum() + likelihood.sum()).backward()
    assert policy.mlp_extractor.actor[0].weight.grad.abs().sum() > 0
    assert policy.mlp_extractor.critic[0].weight.grad.abs().sum() > 0
