from tests.identification import machines


def test_x():
    assert machines.arm
