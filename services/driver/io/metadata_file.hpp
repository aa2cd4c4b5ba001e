#pragma once
// The file in which a sensor describes itself: its beams and the format of its packets.

#include <string>

#include "driver/decoder/maker.hpp"

namespace zloam::driver {

/// The file's bytes. Throws SourceError where it can't be read, or is longer than any description.
std::string text_of_metadata(const std::string& path);

/// Reads the file that is named into the options. Without a name, what lies beside a capture:
/// drive.json, or drive_0.json, for drive.pcap; nothing where there is none. Throws SourceError for
/// a named file that can't be read or describes no sensor that is decoded here.
void read_metadata(const std::string& named, const std::string& capture, DecodingOptions& options);

}  // namespace zloam::driver
