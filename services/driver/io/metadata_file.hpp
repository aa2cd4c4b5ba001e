#pragma once
// The sensor's metadata file: its beams and the format of its packets.

#include <string>

#include "driver/decoder/maker.hpp"

namespace zloam::driver {

/// The file's bytes. Throws SourceError if it can't be read or is longer than any metadata.
std::string text_of_metadata(const std::string& path);

/// Reads the named file into the options. Without a name, the file beside a capture: drive.json, or
/// drive_0.json, for drive.pcap; nothing if there is none. Throws SourceError for a named file that
/// can't be read or describes no sensor that is decoded here.
void read_metadata(const std::string& named, const std::string& capture, DecodingOptions& options);

}  // namespace zloam::driver
