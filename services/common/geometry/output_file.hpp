#pragma once
// A file that is written bit by bit; atomic_file.hpp is for one whose pieces are at hand.

#include <cstddef>
#include <fstream>
#include <string>

namespace zloam {

/// A file that appears under its name only when it is complete; one that was there before stays
/// until then. Devices and pipes are written directly. Throws std::runtime_error with the name.
class OutputFile {
 public:
  explicit OutputFile(const std::string& path);
  ~OutputFile();
  OutputFile(const OutputFile&) = delete;
  OutputFile& operator=(const OutputFile&) = delete;
  void write(const void* data, std::size_t size);
  void write(const std::string& text) { write(text.data(), text.size()); }
  void close();

 private:
  std::string path_;
  std::string temporary_;
  std::ofstream stream_;
  bool is_whole_ = false;
};

}  // namespace zloam
