"""Commands that send requests to the running service; they load neither mathematics nor drivers."""
