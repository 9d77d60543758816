"""Meshes of heads, and where they stand."""

import numpy as np
import pytest

from vergence.models.head_file import load_head, presets
from vergence.viewer.shapes import HeadShapes


@pytest.fixture(scope="module")
def heads():
    return {name: load_head(name) for name in presets()}


@pytest.mark.slow
def test_every_surface_faces_outwards(heads):
    for name, head in heads.items():
        for mesh in HeadShapes(head).meshes:
            corners = mesh.vertices[mesh.faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            outwards = corners.mean(axis=1) - mesh.vertices.mean(axis=0)
            assert (np.einsum("fi,fi->f", normals, outwards) > 0.0).all(), name


def test_a_closed_surface_has_each_edge_twice(heads):
    for mesh in HeadShapes(heads["simulated"]).meshes:
        points = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)[1].ravel()
        faces = points[mesh.faces]
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        edges = edges[edges[:, 0] != edges[:, 1]]
        there = {tuple(edge) for edge in edges.tolist()}
        assert {edge[::-1] for edge in there} == there


@pytest.mark.slow
def test_an_eye_stays_around_its_camera_in_every_posture(heads):
    rng = np.random.default_rng(1)
    for name, head in heads.items():
        shapes = HeadShapes(head)
        q = rng.uniform(0.5 * head.limits.lower, 0.5 * head.limits.upper)
        q = np.where(np.isfinite(q), q, 0.0)
        if not head.actuation.direct:
            q = head.rest()
        cameras = shapes.pose_of_n(q) @ head.camera_poses(q)
        bodies = shapes.body_poses(q)
        for camera in cameras:
            distances = [
                np.linalg.norm(
                    mesh.vertices @ bodies[mesh.body, :3, :3].T
                    + bodies[mesh.body, :3, 3]
                    - camera[:3, 3],
                    axis=1,
                ).min()
                for mesh in shapes.meshes
            ]
            assert min(distances) < 0.025, name
