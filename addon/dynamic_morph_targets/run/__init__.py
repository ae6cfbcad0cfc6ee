# SPDX-License-Identifier: GPL-3.0-or-later
"""What runs: jobs, Live, previews, and the handlers that follow the scene."""
