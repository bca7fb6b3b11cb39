"""Compensation tables in the words of real controllers: text out, and what each of them cannot say.

One module a format. Each knows how its controller reads its file, so signs, references and limits stand there and
nowhere else. Nothing here reads or writes files.
"""
