"""The site: `.ci/docs` stages its pages and those of docs/ in one folder, and runs Sphinx there."""

import rayset

project = "rayset"
version = release = rayset.__version__
author = copyright = "the authors of rayset"
html_show_copyright = False

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
root_doc = "index"
exclude_patterns = ["**/.*"]

myst_enable_extensions = ["colon_fence", "dollarmath", "attrs_block"]
myst_dmath_double_inline = True
myst_dmath_allow_space = False
myst_dmath_allow_digits = False
myst_heading_anchors = 4
# Notebooks are shown as they were executed; CI executes them.
nb_execution_mode = "off"
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_param = False
add_module_names = False

# Names in the package's words lead somewhere; types of signatures need not.
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!rayset\.)[\w.]*"), ("py:.*", r"rayset\._.*"), ("py:class", ".*")]

html_theme = "furo"
html_title = "rayset"
html_static_path = ["_static"]
html_css_files = ["rayset.css"]
html_theme_options = {
    "top_of_page_buttons": [],
    "light_css_variables": {"color-brand-primary": "#a03c12", "color-brand-content": "#a03c12", "color-brand-visited": "#7a4a32"},
    "dark_css_variables": {"color-brand-primary": "#f0a86a", "color-brand-content": "#f0a86a", "color-brand-visited": "#d8b090"},
}
pygments_style = "friendly"
pygments_dark_style = "monokai"
copybutton_exclude = ".linenos, .gp, .go"
