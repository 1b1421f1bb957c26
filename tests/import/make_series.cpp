/// Writes a series in Exodus II: palpate_import_make_series FILE.
#include <vtkExodusIIWriter.h>
#include <vtkNew.h>
#include <vtkTimeSourceExample.h>

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  vtkNew<vtkTimeSourceExample> source;  // hexahedra with values that change from step to step
  source->SetXAmplitude(0.0);
  source->SetYAmplitude(0.0);
  vtkNew<vtkExodusIIWriter> writer;
  writer->SetInputConnection(source->GetOutputPort());
  writer->SetFileName(argv[1]);
  writer->WriteAllTimeStepsOn();
  return writer->Write() == 1 ? 0 : 1;
}
