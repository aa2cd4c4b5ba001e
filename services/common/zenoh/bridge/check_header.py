#!/usr/bin/env python3
"""Compares include/zloam_zenoh.h with src/: every exported function, callback type and struct
must have the same name, the same parameters and fields in the same order, and the same types on
both sides.

Exit code 0: they agree; 1: they differ (the differences are printed). Needs nothing but Python.
"""

import re
import sys
from pathlib import Path

HERE = Path(__file__).parent
HEADER = HERE / "include" / "zloam_zenoh.h"
SOURCES = sorted((HERE / "src").glob("*.rs"))

# Rust type -> C type, for what is not a handle. Handles follow by name: Bytes -> zloam_bytes.
PLAIN = {
    "u8": "uint8_t",
    "u64": "uint64_t",
    "usize": "size_t",
    "bool": "bool",
    "c_void": "void",
    "c_char": "char",
    "Status": "zloam_status",
    "DropFn": "zloam_drop_fn",
}


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def c_type(rust: str) -> str:
    """The C spelling of a Rust type, without blanks before '*'."""
    rust = rust.strip().removeprefix("crate::abi::")
    if rust.startswith("*const "):
        inner = c_type(rust[7:])
        return f"const {inner}*"
    if rust.startswith("*mut "):
        return f"{c_type(rust[5:])}*"
    return PLAIN.get(rust, "zloam_" + snake(rust))


def parameters_of_rust(text: str) -> list[tuple[str, str]]:
    pairs = [part.split(":", 1) for part in text.split(",") if part.strip()]
    return [(name.strip().removeprefix("pub "), c_type(kind)) for name, kind in pairs]


def parameters_of_c(text: str) -> list[tuple[str, str]]:
    result = []
    for part in text.split(","):
        part = part.strip()
        if part in ("", "void"):
            continue
        match = re.fullmatch(r"(.*?[\s*])(\w+)", part, re.S)
        assert match, part
        result.append((match[2], re.sub(r"\s*\*", "*", " ".join(match[1].split()))))
    return result


def read_rust() -> dict[str, object]:
    found: dict[str, object] = {}
    for source in SOURCES:
        text = re.sub(r"//.*", "", source.read_text())
        function = (
            r'#\[no_mangle\]\s*pub (?:unsafe )?extern "C" fn (\w+)'
            r"\((.*?)\)\s*(?:->\s*([^{]+?))?\s*\{"
        )
        for name, arguments, result in re.findall(function, text, re.S):
            found[name] = (c_type(result) if result else "void", parameters_of_rust(arguments))
        callback = r'pub type (\w+)\s*=\s*unsafe extern "C" fn\((.*?)\);'
        for name, arguments in re.findall(callback, text, re.S):
            found[PLAIN.get(name, "zloam_" + snake(name))] = ("void", parameters_of_rust(arguments))
        struct = r"#\[repr\(C\)\](?:\s*#\[[^\]]*\])*\s*pub struct (\w+)\s*\{(.*?)\}"
        for name, fields in re.findall(struct, text, re.S):
            found["zloam_" + snake(name)] = ("struct", parameters_of_rust(fields))
    return found


def read_header() -> dict[str, object]:
    text = re.sub(r"/\*.*?\*/", "", HEADER.read_text(), flags=re.S)
    text = re.sub(r"^\s*#.*$", "", text, flags=re.M)
    found: dict[str, object] = {}
    for name, arguments in re.findall(r"typedef void \(\*(\w+)\)\((.*?)\);", text, re.S):
        found[name] = ("void", parameters_of_c(arguments))
    for name, fields in re.findall(r"typedef struct (\w+) \{(.*?)\}", text, re.S):
        found[name] = ("struct", parameters_of_c(fields.replace(";", ",")))
    text = re.sub(r"typedef[^;{]*(\{.*?\}[^;]*)?;", "", text, flags=re.S)
    for result, name, arguments in re.findall(
        r"([\w ]+?\**)\s*\b(zloam_\w+)\((.*?)\);", text, re.S
    ):
        found[name] = (" ".join(result.split()), parameters_of_c(arguments))
    return found


def main() -> int:
    rust, header = read_rust(), read_header()
    differences = [
        f"{name}:\n  Rust   {rust.get(name)}\n  header {header.get(name)}"
        for name in sorted(rust.keys() | header.keys())
        if rust.get(name) != header.get(name)
    ]
    for difference in differences:
        print(difference)
    print(f"{len(rust)} items in Rust, {len(header)} in the header, {len(differences)} differences")
    return 1 if differences or len(rust) < 30 else 0


if __name__ == "__main__":
    sys.exit(main())
