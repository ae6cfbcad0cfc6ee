# SPDX-License-Identifier: GPL-3.0-or-later
"""The recipes of docs/recipes as code: the characters, the steps of each page, and the files and pictures they make."""
