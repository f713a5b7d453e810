"""Passwords and tokens in addresses, as makers of cameras have them."""

from __future__ import annotations

from tests.cases import each_case

from e3pose.base.masking import has_secret, masked


@each_case(
    ("text", "shown"),
    [
        ("rtsp://admin:Hunter2@10.0.0.7:554/s", "rtsp://admin:***@10.0.0.7:554/s"),
        ("rtsp://admin:p@Hunter2/w@10.0.0.7/x", "rtsp://admin:***@10.0.0.7/x"),
        ("rtsp://Hunter2:@10.0.0.7/x", "rtsp://***@10.0.0.7/x"),
        (
            "rtsp://h/user=admin&password=Hunter2&channel=1&stream=0.sdp?real_stream",
            "rtsp://h/user=admin&password=***&channel=1&stream=0.sdp?real_stream",
        ),
        (
            "rtsp://h/user=admin_password=Hunter2_x_channel=1_stream=0.sdp",
            "rtsp://h/user=admin_password=***_channel=1_stream=0.sdp",
        ),
        ("http://h/v.cgi?loginuse=a&loginpas=Hunter2", "http://h/v.cgi?loginuse=a&loginpas=***"),
        ("http://h/v?usr=a&PWD=Hunter2: refused", "http://h/v?usr=a&PWD=***: refused"),
        ("'rtsp://h/s?t=Hunter2' is not there", "'rtsp://h/s?t=***' is not there"),
        ("http://h/x?auth=Hunter2==&ch=1", "http://h/x?auth=***&ch=1"),
        ("http://h/x?api_key=Hunter2&res=1", "http://h/x?api_key=***&res=1"),
        ("rtsp://h/0/admin:Hunter2/main", "rtsp://h/0/***/main"),
        ("rtsps://h:7441/1Zp3Hunter2Tr7Ym8R?enableSrtp", "rtsps://h:7441/***?enableSrtp"),
        ("rtsp://h:7447/5ca0Hunter2".replace("Hunter2", "f" * 20), "rtsp://h:7447/***"),
        (
            'gstreamer:rtspsrc user-id=a user-pw="Hunter2 x" ! appsink',
            "gstreamer:rtspsrc user-id=a user-pw=*** ! appsink",
        ),
        (
            "a: rtsp://u:Hunter2@h/1; b: rtsp://u:Hunter2@i/2",
            "a: rtsp://u:***@h/1; b: rtsp://u:***@i/2",
        ),
    ],
)
def test_secrets_of_an_address_are_masked(text: str, shown: str) -> None:
    assert has_secret(text)
    assert masked(text) == shown
    assert masked(shown) == shown


@each_case(
    "text",
    [
        "usb:0",
        "walk.mp4",
        "rtsp://10.0.0.7:554/Streaming/Channels/101?transportmode=unicast",
        "http://192.168.178.21:8080/cam?channel=1&subtype=0&resolution=640x480",
        "postgresql://USER@HOST/NAME",
        "tls/edge.local:7447",
        "a password: found 3, expected 2",
        "s3://lab/walks/2026-01-01_pizza",
    ],
)
def test_other_texts_are_shown_as_they_are(text: str) -> None:
    assert masked(text) == text and not has_secret(text)


@each_case("part", ["pas-", "key_a=", "a.", "http://", "t='", "/a:", "aA1", "user-pw="])
def test_a_long_text_takes_no_more_than_its_length(part: str) -> None:
    """A text that a hostile program says; a pattern that tries all ways would never end."""
    text = f"http://x/{part * 30_000}"
    assert len(masked(text)) <= len(text) + 4 * 30_000
