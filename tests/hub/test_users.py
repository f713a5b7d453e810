"""Users of a hub: rights by group, tokens of which only a hash is kept."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest
from tests.cli.commands import run as run_verb

from e3pose.base.errors import InputError
from e3pose_hub.settings import load_hub
from e3pose_hub.users import grant, read_users, revoke, users_of

FILE = """
format = "e3pose-hub"
version = 1
[[site]]
name = "lab"
group = "clinics"
endpoint = "tcp/127.0.0.1:7447"
[[site]]
name = "gym"
group = "sports"
endpoint = "tcp/127.0.0.1:7448"
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    (tmp_path / "hub.toml").write_text(FILE)
    return tmp_path


def test_a_token_has_the_rights_that_were_granted_until_they_are_revoked(house: Path) -> None:
    hub = load_hub(house)
    users = users_of(hub)
    ada, bob = grant(hub, "ada", "operator", ("clinics",)), grant(hub, "bob", "viewer", ("sports",))
    assert (users.scope(ada), users.scope(bob)) == ("write", "read")
    found = users.of_token(bob)
    assert found is not None and hub.of_groups(found.groups) == ["gym"]
    again = grant(hub, "bob", "viewer", ("clinics", "sports"))
    assert users.of_token(bob) is None and users.scope(again) == "read"
    revoke(hub, "ada")
    assert users.scope(ada) is None and [user.name for user in read_users(users.path)] == ["bob"]
    assert users.scope("") is None and users.scope("\ud800") is None


def test_file_is_private_and_has_no_token(house: Path) -> None:
    token = grant(load_hub(house), "ada", "viewer", ("clinics",))
    path = house / "users.toml"
    assert token not in path.read_text() and stat.S_IMODE(path.stat().st_mode) == 0o600


def test_commands_grant_list_and_revoke(house: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_verb("hub", "grant", house, "ada", "--operator", "--group", "clinics") == 0
    assert "ada: token " in capsys.readouterr().out
    assert run_verb("hub", "grant", house, "bob", "--viewer", "--group", "clinics") == 0
    capsys.readouterr()
    assert run_verb("hub", "users", house) == 0
    assert capsys.readouterr().out.split() == [
        "name", "role", "groups", "sites", "ada", "operator", "clinics", "1", "bob", "viewer",
        "clinics", "1",
    ]  # fmt: skip
    assert run_verb("hub", "revoke", house, "bob") == 0
    assert run_verb("hub", "revoke", house, "bob") == 2
    assert "NAME: found 'bob', expected one of ada" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("ada", "--group", "clinics"), "--viewer, --operator: expected one of them"),
        (("ada", "--viewer"), "--group: not found"),
        (("ada", "--viewer", "--group", "x"), "--group: found 'x', expected one of clinics"),
        (("../ada", "--viewer", "--group", "clinics"), "NAME: found '../ada'"),
    ],
)
def test_wrong_grants_are_told(
    house: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    assert run_verb("hub", "grant", house, *words) == 2
    assert said in capsys.readouterr().err
    assert not (house / "users.toml").exists()


@pytest.mark.parametrize("text", ["x = 1", 'format = "x"', "user = 1", "[[user]]\nname = 'a'"])
def test_wrong_file_of_users_lets_nobody_in(house: Path, text: str) -> None:
    (house / "users.toml").write_text(text)
    with pytest.raises(InputError, match=r"users\.toml"):
        users_of(load_hub(house)).scope("token")
