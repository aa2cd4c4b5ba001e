"""A page for a person without any tool: robots, their health, path, map and latency.

robot_view  contents of the page for one robot, from what any subscriber receives
server      serves page and contents to browsers
page.html, page.css, page.js  the page: no build step, no resources from elsewhere
"""
