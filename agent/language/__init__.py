"""German for the texts that the program makes in English.

A text is made, stored in the journal and given to programs in English. Whoever shows it to a person in German asks
`in_language`, which looks the sentence up in the catalogue: the files of the folder `german`, one for each room of the
source. A line of a file is a sentence in English and beside it in German, with named places for what is filled in.
`composed.json` has those that the source puts together of several parts. The catalogue is complete if
tests/unit/agent/test_german_sentences.py passes: it names each sentence of the source that has no German.
"""
