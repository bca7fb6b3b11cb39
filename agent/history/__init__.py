"""Every run of every machine, its trends and what they warn of. Journals are the truth; history is fed from them."""
