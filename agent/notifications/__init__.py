"""Notices about alarms and the ends of runs, and their delivery by MQTT, HTTP and mail."""
