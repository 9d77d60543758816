"""`vergence export onnx`: what other tools get of a network, and what is refused."""

import onnxruntime

from tests.test_cli import call


def test_a_shipped_network_is_exported_and_nothing_is_overwritten(tmp_path, capsys) -> None:
    out = tmp_path / "policy.onnx"
    assert call("export", "onnx", "policy-simulated", str(out)) == 0
    (port,) = onnxruntime.InferenceSession(out).get_inputs()
    assert (port.name, port.shape) == ("inputs", ["batch", 76])
    written = out.read_bytes()
    for words, said in (
        (("policy-simulated", str(out)), "--force"),
        (("policy-simulated", "out.zip"), "ends in .onnx"),
        (("nothing", "out.onnx"), "expected a file named *.vgp or one of the shipped"),
        (("missing.vgp", "out.onnx"), "missing.vgp: expected a file"),
    ):
        capsys.readouterr()
        assert call("export", "onnx", *words) == 2
        assert said in capsys.readouterr().err
    assert out.read_bytes() == written
