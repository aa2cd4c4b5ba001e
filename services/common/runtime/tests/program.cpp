// The smallest stage, for tests of what a whole program does.

#include "common/runtime/stage.hpp"

int main(int argc, char** argv) {
  using namespace zloam;
  double value = 1.0;
  std::string fail;
  return runtime::run_stage(
      argc, argv,
      {.name = "registration",
       .summary = "A stage for tests.",
       .bind =
           [&](runtime::Parameters& p) {
             p.add("registration.value", &value, {0.0, 2.0}, "m", "a value");
             p.add("registration.fail", &fail, {"", "io", "other", "later", "unsaved", "waits"},
                   "how to fail");
           },
       .wire =
           [&](runtime::Stage& stage) {
             if (fail == "io") throw runtime::IoError("the disk is gone");
             if (fail == "other") throw std::runtime_error("anything else");
             if (fail == "later") stage.fail("gave up");
             if (fail == "waits") stage.ready(false, "nothing to work on");
             if (fail == "unsaved")
               stage.on_stop([] { throw runtime::IoError("the disk is full"); });
             stage.on_stop([] { runtime::log_info("saved before the end"); });
           }});
}
